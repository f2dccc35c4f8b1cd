"""What `/diagnostics` says of a rig and its cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from autoexpose_ros.status import Camera, Status

OK, WARN, ERROR, STALE = range(4)
_LEVELS = {"exposing": OK, "starting": WARN, "degraded": WARN, "failed": ERROR}
_WARM_C = 70.0
"""Machine-vision cameras are specified up to 65 or so inside; what they name differs."""


@dataclass(frozen=True)
class Entry:
    """A DiagnosticStatus."""

    level: int
    name: str
    message: str
    hardware_id: str = ""
    values: dict[str, str] = field(default_factory=dict)


def entries(rig: str, status: Status | None) -> Iterator[Entry]:
    """One for the rig, and one for each camera; without a status, it says that the daemon is silent."""
    if status is None:
        yield Entry(STALE, f"{rig}: exposure", "nothing heard from the daemon")
        return
    words = ": ".join(filter(None, (status.state, "; ".join(status.reasons))))
    yield Entry(_LEVELS.get(status.state, ERROR), f"{rig}: exposure", words, "", dict(_of_rig(status)))
    for name, camera in status.cameras.items():
        level, words = _judged(camera)
        yield Entry(level, f"{rig}: {name} camera", words, camera.hardware or "", dict(_of_camera(camera)))


def _of_rig(status: Status) -> Iterator[tuple[str, str]]:
    several = len(status.groups) > 1
    for name, group in status.groups.items():
        of = f"{name}: " if several else ""
        yield f"{of}policy", group.policy
        if group.locked:
            yield f"{of}locked", "yes"
        if group.ev_stops:
            yield f"{of}EV", f"{group.ev_stops:+g}"
    yield "sets per second", f"{status.rate_hz:.1f}"
    yield from ((name.replace("_", " "), str(count)) for name, count in status.counts.items() if count)
    yield "lost", ", ".join(f"{count} {reason}" for reason, count in status.lost.items()) or "none"
    if status.shares is not None:
        yield "saturated share", f"{status.shares[0]:.3f}"
        yield "black share", f"{status.shares[1]:.3f}"
    if status.frame_to_node_p99_ms is not None:
        yield "frame to node p99 ms", f"{status.frame_to_node_p99_ms:.1f}"


def _judged(camera: Camera) -> tuple[int, str]:
    if camera.hardware is None:
        return ERROR, "gone"
    if camera.misfit is not None:
        return WARN, camera.misfit
    if camera.temperature_c is not None and camera.temperature_c >= _WARM_C:
        return WARN, f"{camera.temperature_c:.0f} degrees C: cool it"
    return OK, "open"


def _of_camera(camera: Camera) -> Iterator[tuple[str, str]]:
    if camera.exposure is not None:
        yield "exposure time us", f"{camera.exposure[0]:.0f}"
        yield "gain dB", f"{camera.exposure[1]:.1f}"
    if camera.temperature_c is not None:
        yield "temperature degrees C", f"{camera.temperature_c:.1f}"
    if camera.link_mbps is not None:
        yield "link Mbit/s", f"{camera.link_mbps:.0f}"
    yield "frames", str(camera.frames)
    yield "frames lost", str(camera.lost)
