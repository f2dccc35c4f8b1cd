"""The page's buttons: who may press them, and that control does what they say."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tests.autoexpose_daemon.page.browser import browser
from tests.autoexpose_daemon.page.server import running_page
from tests.autoexpose_daemon.publish.steps import endpoint, wait_until
from tests.autoexpose_daemon.scripted import scripted_daemon

TOKEN = "0123456789abcdef-token"
WITH_TOKEN = {"Authorization": f"Bearer {TOKEN}"}

pytestmark = pytest.mark.wire


def token_file(folder: Path) -> str:
    file = folder / "token"
    file.write_text(TOKEN)
    return str(file)


def test_a_page_without_a_token_changes_nothing() -> None:
    with running_page("--connect", endpoint()) as page:
        assert page.ask("POST", "/control", {}, '{"locked": true}')[0] == 404


def test_only_who_has_the_token_may_ask_and_only_for_what_there_are_buttons(tmp_path: Path) -> None:
    with running_page("--connect", endpoint(), "--token-file", token_file(tmp_path)) as page:
        assert page.ask("POST", "/control", {}, '{"locked": true}')[0] == 401
        elsewhere = WITH_TOKEN | {"Origin": "http://evil.example"}
        assert page.ask("POST", "/control", elsewhere, '{"locked": true}')[0] == 403
        assert page.ask("GET", "/control", WITH_TOKEN)[0] == 405
        for body in ("", "{}", "[]", "{", '{"shot": {"exposure_time_us": 1}}', '{"by": "user"}', "[" * 1000):
            status, words, _ = page.ask("POST", "/control", WITH_TOKEN, body)
            assert (status, "give a JSON object with some of" in words) == (400, True), body
        assert page.ask("POST", "/control", WITH_TOKEN, json.dumps({"policy": "x" * 2000}))[0] == 413
        status, words, _ = page.ask("POST", "/control", WITH_TOKEN, '{"locked": true}')
        assert status == 409 and "no answer for rig rig" in words
        page.hang_up("/control", WITH_TOKEN)
        assert page.get("/login")[0] == 200
        assert page.stop() == 0
        assert "Traceback" not in page.log


@pytest.mark.needs("chromium")
def test_what_is_pressed_applies(tmp_path: Path) -> None:
    at = endpoint()
    with (
        running_page("--connect", at, "--token-file", token_file(tmp_path)) as page,
        browser() as tab,
        scripted_daemon(publish={"listen": [at]}) as (daemon, _, _),
    ):
        asked = daemon.telemetry.requests
        tab.open(f"{page.url}/login")
        tab.value(f"document.querySelector('input').value = '{TOKEN}'; document.querySelector('form').submit()")
        tab.wait_for("document.getElementById('buttons')?.checkVisibility()", "buttons")
        tab.value("document.getElementById('lock').click()")
        wait_until(lambda: asked.locked is not None and asked.latest == "lock, asked by page", "the lock")
        tab.wait_for("document.getElementById('lock').innerText === 'unlock'", "the lock on the page")
        assert tab.text("asked") == "lock, asked by page"
        status, words, _ = page.ask("POST", "/control", WITH_TOKEN, '{"ev_stops": 9}')
        assert (status, words) == (409, "ev_stops: 9.0 is out of bounds: give -3 to 3 stops\n")
        for _ in range(2):  # sooner than a status shows the first
            tab.value("document.getElementById('darker').click()")
        wait_until(lambda: asked.ev_stops == -1.0, "the compensation")
        tab.value(
            "(() => { const choice = document.getElementById('policies'); choice.value = 'neves2009';"
            "choice.dispatchEvent(new Event('change')); })()"
        )
        wait_until(lambda: daemon.tuning.config.control.policy == "neves2009", "the policy")
        tab.wait_for("document.getElementById('policy').innerText.includes('by neves2009')", "the policy on the page")
        if "PAGE_SCREENSHOTS" in os.environ:
            tab.screen(1300, 900)
            tab.screenshot(Path(os.environ["PAGE_SCREENSHOTS"]) / "page-buttons.png")
        tab.value("document.getElementById('reset').click()")
        wait_until(lambda: asked.locked is None and not asked.changed, "the configuration")
        assert tab.complaints == []
