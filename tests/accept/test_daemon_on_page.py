"""A daemon on two fake cameras, in real time, as its page shows it; and the screenshots of the docs.

With PAGE_SCREENSHOTS=FOLDER the test writes them there, after `HISTORY_S` of history.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from tests.autoexpose_daemon.page.browser import SHRUNK, Tab, browser
from tests.autoexpose_daemon.page.server import running_page
from tests.autoexpose_daemon.page.test_page import STATE, compare
from tests.autoexpose_daemon.publish.steps import endpoint
from tests.autoexpose_daemon.stereo import running_daemon, stereo_cameras

SCREENSHOTS = os.environ.get("PAGE_SCREENSHOTS")
HISTORY_S = 55.0
SCREENSHOT_RATE_HZ = 20.0
"""A browser without a graphics card takes its share of the machine."""

pytestmark = pytest.mark.realtime


@pytest.mark.timeout(300)
def test_what_is_shown_is_what_was_published(monkeypatch: pytest.MonkeyPatch) -> None:
    at = endpoint()
    settings: dict[str, Any] = {"publish": {"listen": [at]}}
    options: list[str] = []
    if SCREENSHOTS is None:
        settings["control"] = {"policy": "neves2009"}
    else:
        settings["trigger"] = {"rate_hz": SCREENSHOT_RATE_HZ}
        options = ["--line0-rate-hz", str(SCREENSHOT_RATE_HZ)]
    with (
        running_page("--connect", at) as page,
        browser() as tab,
        stereo_cameras(*options) as cameras,
        running_daemon(cameras, settings) as run,
    ):
        tab.screen(1280, 900)
        tab.open(page.url)
        tab.wait_for(f"{STATE} === 'exposing' && !document.querySelector('.stale')", "pictures")
        tab.wait_for("document.querySelector('.curve-words').innerText !== ''", "a prediction curve")
        compare(tab, run.seen)
        for canvas in (".curve", ".lane canvas"):
            assert len(set(tab.value(f"{SHRUNK}('{canvas}', 40, 20)"))) > 5
        if SCREENSHOTS is not None:
            take_screenshots(tab, Path(SCREENSHOTS))
        assert tab.complaints == []
        assert page.stop() == 0
        assert "Traceback" not in page.log


def take_screenshots(tab: Tab, folder: Path) -> None:
    """After a minute of the fakes' lights, at moments when there is something to see; the machine must keep up."""
    tab.wait_for(f"performance.now() > {1000 * HISTORY_S}", "some history", 2 * HISTORY_S)
    shares = ("saturated", "black")
    steady = (
        f"parseFloat(document.getElementById('headline').innerText.split('pairs/s')[1]) > {0.9 * SCREENSHOT_RATE_HZ}"
    )
    left = "document.querySelector('[data-camera=left] dd.{}').innerText"
    saturated, black = (f"parseFloat({left.format(share)})" for share in shares)
    for name, width, height, dark in (("page", 1280, 900, False), ("page-phone", 390, 844, True)):
        tab.screen(width, height, dark, scale=1.0 if width > 1000 else 1.5)
        worth_showing = f"{steady} && {saturated} > 1 && {saturated} < 12 && {black} < 12"
        tab.wait_for(f"{STATE} === 'exposing' && {worth_showing}", "a picture worth showing", HISTORY_S)
        file = folder / f"{name}.png"
        tab.screenshot(file, whole=width > 1000)
        with Image.open(file) as picture:
            picture.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(file, optimize=True)
