"""What is wrong with a camera is logged once, and shown while it lasts."""

from __future__ import annotations

import logging

import pytest

from autoexpose_daemon.runtime.rig_health import Complaints


@pytest.fixture
def complaints(caplog: pytest.LogCaptureFixture) -> Complaints:
    caplog.set_level(logging.WARNING)
    return Complaints({})


def test_a_complaint_is_logged_when_it_begins_and_when_it_returns(
    complaints: Complaints, caplog: pytest.LogCaptureFixture
) -> None:
    complaints.begin("left", "refused", "1 us was refused")
    complaints.begin("left", "refused", "2 us was refused")
    assert complaints.present == {("left", "refused"): "1 us was refused"}
    complaints.end("left", "refused")
    assert complaints.present == {}
    complaints.begin("left", "refused", "3 us was refused")
    assert caplog.messages == ["left camera: 1 us was refused", "left camera: 3 us was refused"]


def test_each_new_sentence_about_a_lost_camera_is_logged_once_however_they_alternate(
    complaints: Complaints, caplog: pytest.LogCaptureFixture
) -> None:
    for sentence in ("no answer", "another serial", "no answer", "another serial"):
        complaints.change("left", "gone", sentence)
        assert complaints.present == {("left", "gone"): sentence}
    assert caplog.messages == ["left camera: no answer", "left camera: another serial"]
    complaints.end("left", "gone")
    complaints.change("left", "gone", "no answer")
    assert len(caplog.messages) == 3


def test_a_verdict_is_logged_when_it_changes(complaints: Complaints, caplog: pytest.LogCaptureFixture) -> None:
    for verdict in (None, "120 Hz", "120 Hz", "30 Hz", None):
        complaints.judge("right", "rate", verdict)
    assert caplog.messages == ["right camera: 120 Hz", "right camera: 30 Hz"]
    assert complaints.present == {}


def test_a_cameras_complaints_go_with_it_and_no_others(complaints: Complaints) -> None:
    for side in ("left", "right"):
        for kind in ("refused", "rate"):
            complaints.begin(side, kind, "wrong")  # type: ignore[arg-type]
    complaints.end_all("left")
    assert complaints.present.keys() == {("right", "refused"), ("right", "rate")}
