from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from autoexpose_daemon.messages.types import DIAGNOSTICS, TYPESTORE
from autoexpose_daemon.ros2.diagnostics import ERROR, OK, STALE, WARN, diagnostics
from autoexpose_daemon.status.document import CameraStatus, Status
from autoexpose_daemon.status.states import State
from tests.autoexpose_daemon.statuses import EXPOSING


def shown(status: Status | None) -> dict[str, Any]:
    """The entries by name."""
    message: Any = TYPESTORE.deserialize_cdr(diagnostics("scout", status, 1_700_000_000_000_000_005), DIAGNOSTICS)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 5)
    return {entry.name: entry for entry in message.status}


def test_a_rig_that_exposes_is_ok_with_its_figures() -> None:
    entries = shown(EXPOSING)
    assert list(entries) == ["scout: exposure", "scout: left camera", "scout: right camera"]
    assert {entry.level for entry in entries.values()} == {OK}
    values = {pair.key: pair.value for pair in entries["scout: exposure"].values}
    assert values["policy"] == "belief"
    assert values["exposure time us"] == "1100"
    assert entries["scout: left camera"].hardware_id == "FakeCam L1"


@pytest.mark.parametrize(
    ("state", "level"), [(State.STARTING, WARN), (State.DEGRADED, WARN), (State.FAILED, ERROR), (State.EXPOSING, OK)]
)
def test_a_state_has_a_level_and_its_reasons(state: State, level: int) -> None:
    rig = shown(replace(EXPOSING, state=state, reasons=("left camera gone", "no triggers")))["scout: exposure"]
    assert (rig.level, rig.message) == (level, f"{state}: left camera gone; no triggers")


def test_cameras_that_are_gone_or_do_not_fit_show() -> None:
    cameras = {"left": CameraStatus(None, None, None, None), "right": CameraStatus("C R", None, None, "other lens")}
    entries = shown(replace(EXPOSING, cameras=cameras))
    assert (entries["scout: left camera"].level, entries["scout: left camera"].message) == (ERROR, "gone")
    assert (entries["scout: right camera"].level, entries["scout: right camera"].message) == (WARN, "other lens")


def test_silence_is_stale() -> None:
    (entry,) = shown(None).values()
    assert (entry.level, entry.message) == (STALE, "nothing heard from the daemon")
