"""A daemon as its page shows it, on scripted cameras; tests/accept has the same on fake cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest

from autoexpose_daemon.control.decision import Decision
from imaging.frames import StereoPair
from tests.autoexpose_daemon.page.browser import SHRUNK, Tab, browser
from tests.autoexpose_daemon.page.server import running_page
from tests.autoexpose_daemon.publish.steps import endpoint
from tests.autoexpose_daemon.scripted import scripted_daemon

SHAPE = (27, 36)
STATE = "document.getElementById('state-word').innerText"

pytestmark = [pytest.mark.wire, pytest.mark.needs("chromium")]


def test_what_is_shown_is_what_was_published() -> None:
    at = endpoint()
    with (
        running_page("--connect", at) as page,
        browser() as tab,
        scripted_daemon(control={"policy": "neves2009"}, publish={"listen": [at]}) as (_, _, seen),
    ):
        tab.open(page.url)
        tab.wait_for(f"{STATE} === 'exposing' && !document.querySelector('.stale')", "pictures")
        tab.wait_for("document.getElementById('curve-words').innerText !== ''", "a prediction curve")
        compare(tab, seen)
        for canvas in ("#curve", ".lane canvas"):
            assert len(set(tab.value(f"{SHRUNK}('{canvas}', 40, 20)"))) > 5
        assert tab.complaints == []
        assert page.stop() == 0
        assert "Traceback" not in page.log


def compare(tab: Tab, run: Sequence[tuple[StereoPair, Decision | None]]) -> None:
    """A pair on the page, picture and numbers, with that of control; one that was decided on, while there is light."""
    seen: dict[int, Any] = {}
    while (shown := look(tab))["trigger"] not in seen:
        decided = [(pair, decision) for pair, decision in list(run) if decision is not None]
        seen = {pair.trigger: (pair, decision) for pair, decision in decided if pair.reference.pixels.std() > 10}
    pair, decision = seen[shown["trigger"]]
    for words in (f"metric {decision.metric:.4f}", f"level {decision.level:.2f} stops"):
        assert words in shown["decision"]
    assert decision.reason in shown["decision"]
    assert f"metric {decision.metric:.4f}" in shown["left"]
    for side, frame in (("left", pair.frames["left"]), ("right", pair.frames["right"])):
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
