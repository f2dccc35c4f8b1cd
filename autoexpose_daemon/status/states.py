"""The state of the daemon, judged from its telemetry alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from autoexpose_daemon.status.telemetry import GONE, Telemetry
from imaging.frames import CameraName
from imaging.python310 import StrEnum

START_PATIENCE_NS = 10_000_000_000
"""A rig without a pair this long after its start is no longer starting. A GigE Vision camera stays with a killed
controller for 3 s; two searches of a second each, and the pauses between them, add to that."""

ADJUSTED = "adjusted"
"""The kind of trouble that does not degrade: cameras round, and frames carry the setting they were taken with."""

SILENCE_NS = 1_000_000_000
SILENCE_PERIODS = 5.0
"""A camera that sends nothing for a second and for five trigger periods is silent."""


class State(StrEnum):
    """The names are fixed for the log, `systemctl status` and metrics."""

    STARTING = "starting"
    EXPOSING = "exposing"
    DEGRADED = "degraded"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Health:
    """A state, and the reasons why it is not better, each in words for the operator."""

    state: State
    reasons: tuple[str, ...] = ()

    def __str__(self) -> str:
        return ": ".join([self.state, *(["; ".join(self.reasons)] if self.reasons else [])])


@dataclass(frozen=True, slots=True)
class Expectation:
    """What a rig should deliver: its cameras, the period of their frames (s), and since when (CLOCK_MONOTONIC)."""

    cameras: Sequence[CameraName]
    period_s: float
    triggered: bool
    since_ns: int

    @property
    def silence_ns(self) -> float:
        """A camera without frames for longer than this is silent."""
        return max(SILENCE_NS, SILENCE_PERIODS * self.period_s * 1e9)


def judge(telemetry: Telemetry, expected: Expectation, now_ns: int) -> Health:
    """The state at `now_ns`. A stopped trigger or a lost camera only degrades it; neither fails it."""
    if telemetry.failure is not None:
        return Health(State.FAILED, (telemetry.failure,))
    if telemetry.last_pair_ns is None and now_ns - expected.since_ns < max(START_PATIENCE_NS, expected.silence_ns):
        return Health(State.STARTING)
    reasons = tuple(_reasons(telemetry, expected, now_ns))
    return Health(State.DEGRADED, reasons) if reasons else Health(State.EXPOSING)


def _reasons(telemetry: Telemetry, expected: Expectation, now_ns: int) -> Iterator[str]:
    seen = telemetry.cameras
    cameras = {name: seen.names.get(name, GONE) for name in expected.cameras}
    gone = [name for name, camera in cameras.items() if camera == GONE]
    present = [name for name in cameras if name not in gone]
    troubles = seen.troubles.copy()  # the control thread changes it
    incomplete = [name for name in present if (name, "incomplete") in troubles]
    whole = [name for name in present if name not in incomplete]
    silent = [name for name in whole if _silent(seen.last_frame_ns.get(name), expected, now_ns)]
    # The last frame of one camera before the trigger stops may be lost: it then falls silent a little earlier.
    soon_ns = now_ns + round(expected.silence_ns / 2)
    if silent and all(_silent(seen.last_frame_ns.get(name), expected, soon_ns) for name in whole):
        silent = whole
    for name in gone:
        yield f"{name} camera gone" + (f": {troubles[name, GONE]}" if (name, GONE) in troubles else "")
    if silent and silent == present:
        yield "no triggers" if expected.triggered else "no frames"
    else:
        for name in silent:
            yield f"no frames from the {name} camera"
    # Twice as patient: when the trigger stops, one camera's last frame may be a little later than the last pair.
    if not (gone or silent or incomplete) and _silent(
        telemetry.last_pair_ns, expected, now_ns - round(expected.silence_ns)
    ):
        yield "frames form no whole sets" if len(expected.cameras) > 2 else "frames form no stereo pairs"
    for (name, kind), trouble in troubles.items():
        if kind not in (GONE, ADJUSTED):
            yield f"{name} camera: {trouble}"
    for name, misfit in list(seen.misfits.items()):  # the control thread adds to it
        yield f"calibration of the {name} camera does not fit: {misfit}"
    if telemetry.publishing is not None and telemetry.publishing.trouble:
        yield f"frames are not published: {telemetry.publishing.trouble}"
    if telemetry.imu is not None and telemetry.imu.trouble:
        yield f"image speed comes from optical flow: {telemetry.imu.trouble}"


def _silent(last_ns: int | None, expected: Expectation, now_ns: int) -> bool:
    return last_ns is None or now_ns - last_ns > expected.silence_ns
