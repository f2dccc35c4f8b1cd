"""The daemon's status as a DiagnosticArray of ROS 2: one entry for the rig, one for each camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from autoexpose_daemon.messages.types import DIAGNOSTICS, TYPESTORE, header, serialise
from autoexpose_daemon.status.counters import unusual_counts
from autoexpose_daemon.status.document import CameraStatus, Status
from autoexpose_daemon.status.panel import lost_in_words
from autoexpose_daemon.status.states import State

OK, WARN, ERROR, STALE = range(4)
_LEVELS = {State.EXPOSING: OK, State.STARTING: WARN, State.DEGRADED: WARN, State.FAILED: ERROR}


def diagnostics(rig: str, status: Status | None, stamp_ns: int) -> bytes:
    """The message in CDR; without a status, it says that the daemon is silent. `stamp_ns` is CLOCK_REALTIME."""
    if status is None:
        entries = [_entry(STALE, f"{rig}: exposure", "nothing heard from the daemon", "", {})]
    else:
        reasons = "; ".join(status.reasons)
        words = f"{status.state}: {reasons}" if reasons else str(status.state)
        entries = [_entry(_LEVELS[status.state], f"{rig}: exposure", words, "", dict(_of_rig(status)))]
        entries += [_of_camera(rig, side, camera) for side, camera in status.cameras.items()]
    message = TYPESTORE.types[DIAGNOSTICS](header(stamp_ns, ""), entries)
    return serialise(message, DIAGNOSTICS)


def _of_rig(status: Status) -> Iterator[tuple[str, str]]:
    yield "policy", status.policy
    yield "pairs", str(status.counts.pairs)
    yield "pairs per second", f"{status.rate_hz:.1f}"
    yield "lost", lost_in_words(status.lost)
    yield from ((counter.label, str(count)) for counter, count in unusual_counts(status.counts))
    if status.decision is not None:
        yield "exposure time us", f"{status.decision.setting.exposure_time_us:.0f}"
        yield "gain dB", f"{status.decision.setting.gain_db:.1f}"
        yield "saturated share", f"{status.decision.saturated_share:.3f}"
        yield "black share", f"{status.decision.black_share:.3f}"
    if status.frame_to_node_ms.p99_ms is not None:
        yield "frame to node p99 ms", f"{status.frame_to_node_ms.p99_ms:.1f}"
    if requested := str(status.requests or ""):
        yield "requested", requested


def _of_camera(rig: str, side: str, camera: CameraStatus) -> Any:
    values = {}
    if camera.applied is not None:
        values = {
            "exposure time us": f"{camera.applied.exposure_time_us:.0f}",
            "gain dB": f"{camera.applied.gain_db:.1f}",
        }
    if camera.camera is None:
        level, words = ERROR, "gone"
    elif camera.misfit is not None:
        level, words = WARN, camera.misfit
    else:
        level, words = OK, "open"
    return _entry(level, f"{rig}: {side} camera", words, camera.camera or "", values)


def _entry(level: int, name: str, message: str, hardware_id: str, values: Mapping[str, str]) -> Any:
    key_value = TYPESTORE.types["diagnostic_msgs/msg/KeyValue"]
    entry = TYPESTORE.types["diagnostic_msgs/msg/DiagnosticStatus"]
    return entry(level, name, message, hardware_id, [key_value(key, value) for key, value in values.items()])
