"""What is wrong with a camera is logged once, and shown while it lasts."""

from __future__ import annotations

import logging

import pytest

from autoexpose_daemon.runtime.rig_health import Troubles


@pytest.fixture
def troubles(caplog: pytest.LogCaptureFixture) -> Troubles:
    caplog.set_level(logging.WARNING)
    return Troubles({})


def test_a_trouble_is_logged_when_it_begins_and_when_it_returns(
    troubles: Troubles, caplog: pytest.LogCaptureFixture
) -> None:
    troubles.begin("left", "refused", "1 us was refused")
    troubles.begin("left", "refused", "2 us was refused")
    assert troubles.present == {("left", "refused"): "1 us was refused"}
    troubles.end("left", "refused")
    assert troubles.present == {}
    troubles.begin("left", "refused", "3 us was refused")
    assert caplog.messages == ["left camera: 1 us was refused", "left camera: 3 us was refused"]


def test_each_new_sentence_about_a_lost_camera_is_logged_once_however_they_alternate(
    troubles: Troubles, caplog: pytest.LogCaptureFixture
) -> None:
    for sentence in ("no answer", "another serial", "no answer", "another serial"):
        troubles.change("left", "gone", sentence)
        assert troubles.present == {("left", "gone"): sentence}
    assert caplog.messages == ["left camera: no answer", "left camera: another serial"]
    troubles.end("left", "gone")
    troubles.change("left", "gone", "no answer")
    assert len(caplog.messages) == 3


def test_a_verdict_is_logged_when_it_changes(troubles: Troubles, caplog: pytest.LogCaptureFixture) -> None:
    for verdict in (None, "120 Hz", "120 Hz", "30 Hz", None):
        troubles.judge("right", "rate", verdict)
    assert caplog.messages == ["right camera: 120 Hz", "right camera: 30 Hz"]
    assert troubles.present == {}


def test_a_cameras_troubles_go_with_it_and_no_others(troubles: Troubles) -> None:
    for side in ("left", "right"):
        for kind in ("refused", "rate"):
            troubles.begin(side, kind, "wrong")  # type: ignore[arg-type]
    troubles.end_all("left")
    assert troubles.present.keys() == {("right", "refused"), ("right", "rate")}
