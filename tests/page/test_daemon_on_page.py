"""A real daemon on two fake cameras, as its page shows it; and the screenshots of the docs.

With PAGE_SCREENSHOTS=FOLDER the test writes them there, after `HISTORY_S` of history.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.autoexpose_daemon.stereo import Run, running_daemon, stereo_cameras
from tests.page.browser import SHRUNK, Tab, browser
from tests.page.server import running_page
from tests.publish.steps import endpoint

SCREENSHOTS = os.environ.get("PAGE_SCREENSHOTS")
HISTORY_S = 55.0
SCREENSHOT_RATE_HZ = 20.0
"""A browser without a graphics card takes its share of the machine."""

SHAPE = (27, 36)
STATE = "document.getElementById('state-word').innerText"

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
        tab.wait_for("document.getElementById('curve-words').innerText !== ''", "a prediction curve")
        compare(tab, run)
        for canvas in ("#curve", ".lane canvas"):
            assert len(set(tab.value(f"{SHRUNK}('{canvas}', 40, 20)"))) > 5
        if SCREENSHOTS is not None:
            take_screenshots(tab, Path(SCREENSHOTS))
        assert tab.complaints == []
        assert page.stop() == 0
        assert "Traceback" not in page.log


def compare(tab: Tab, run: Run) -> None:
    """A pair on the page, picture and numbers, with that of control; one that was decided on, while there is light."""
    seen: dict[int, Any] = {}
    while (shown := look(tab))["trigger"] not in seen:
        seen = {pair.trigger: (pair, decision) for pair, decision in list(run.seen) if pair.left.pixels.std() > 10}
    pair, decision = seen[shown["trigger"]]
    for words in (f"metric {decision.metric:.4f}", f"level {decision.level:.2f} stops"):
        assert words in shown["decision"]
    assert decision.reason in shown["decision"]
    assert f"metric {decision.metric:.4f}" in shown["left"]
    for side, frame in (("left", pair.left), ("right", pair.right)):
        assert f"gain {frame.setting.gain_db:.1f} dB" in shown[side]
        taken = cv2.resize(frame.pixels, SHAPE[::-1], interpolation=cv2.INTER_AREA).ravel()
        drawn = np.array(shown[f"{side} pixels"])
        assert np.corrcoef(taken, drawn)[0, 1] > 0.9


def look(tab: Tab) -> dict[str, Any]:
    """What the page shows of one pair, at one moment."""
    height, width = SHAPE
    expression = f"""(() => {{
      const words = (selector) => document.querySelector(selector).innerText.replaceAll("\\n", " ");
      const shown = {{ trigger: Number(document.body.dataset.trigger), decision: words("#decision") }};
      for (const side of ["left", "right"]) {{
        shown[side] = words(`#${{side}} figcaption`);
        shown[`${{side}} pixels`] = {SHRUNK}(`#${{side}} canvas`, {width}, {height});
      }}
      return shown;
    }})()"""
    shown: dict[str, Any] = tab.value(expression)
    return shown


def take_screenshots(tab: Tab, folder: Path) -> None:
    """After a minute of the fakes' lights, at moments when there is something to see; the machine must keep up."""
    tab.wait_for(f"performance.now() > {1000 * HISTORY_S}", "some history", 2 * HISTORY_S)
    shares = ("saturated", "black")
    steady = (
        f"parseFloat(document.getElementById('headline').innerText.split('pairs/s')[1]) > {0.9 * SCREENSHOT_RATE_HZ}"
    )
    saturated, black = (f"parseFloat(document.querySelector('#left dd.{share}').innerText)" for share in shares)
    for name, width, height, dark in (("page", 1280, 900, False), ("page-phone", 390, 844, True)):
        tab.screen(width, height, dark, scale=1.0 if width > 1000 else 1.5)
        worth_showing = f"{steady} && {saturated} > 1 && {saturated} < 12 && {black} < 12"
        tab.wait_for(f"{STATE} === 'exposing' && {worth_showing}", "a picture worth showing", HISTORY_S)
        file = folder / f"{name}.png"
        tab.screenshot(file, whole=width > 1000)
        with Image.open(file) as picture:
            picture.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(file, optimize=True)
