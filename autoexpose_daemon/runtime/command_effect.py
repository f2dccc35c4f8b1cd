"""How long it takes from the decision on a setting to the first exposure with it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from drivers.exposure import DB_PER_STOP, ExposureSetting
from drivers.frames import Frame, Side

_REMEMBERED = 64
"""Settings on their way: a third of a second at 200 Hz, longer than any camera takes."""


@dataclass(slots=True)
class _Camera:
    shown: ExposureSetting | None = None
    commands: deque[tuple[int, ExposureSetting]] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))


class CommandToEffect:
    """Finds the settings that were decided on again in frames that say themselves how they were taken.

    A frame shows the nearest to its own setting, of those decided on before its exposure and the one shown last: so a
    setting that a newer one overtook is not taken for it, nor is a step too small for the camera.
    """

    def __init__(self, sides: Sequence[Side]) -> None:
        self._cameras = {side: _Camera() for side in sides}

    def commanded(self, setting: ExposureSetting, now_ns: int) -> None:
        """A new setting was decided on, at this moment (CLOCK_MONOTONIC)."""
        for camera in self._cameras.values():
            camera.commands.append((now_ns, setting))

    def gone(self, side: Side) -> None:
        """A camera is lost: what it was to take is forgotten."""
        self._cameras[side] = _Camera()

    def shown(self, side: Side, frame: Frame) -> int | None:
        """How long (ns) it took from the decision to this frame, if it is the first to show a new setting."""
        if frame.setting_source != "chunk":
            return None
        camera = self._cameras[side]
        last, camera.shown = camera.shown, frame.setting
        candidates = [
            (_stops_apart(frame.setting, setting), commanded_ns)  # of equally near ones the oldest
            for commanded_ns, setting in camera.commands
            if commanded_ns < frame.host_time_ns and frame.setting.agrees_with(setting)
        ]
        if not candidates:
            return None
        apart, commanded_ns = min(candidates)
        if last is not None and _stops_apart(frame.setting, last) <= apart:
            return None
        while camera.commands and camera.commands[0][0] <= commanded_ns:
            camera.commands.popleft()
        return frame.host_time_ns - commanded_ns


def _stops_apart(one: ExposureSetting, other: ExposureSetting) -> float:
    """How far two settings are apart, time and gain each for itself (stops)."""
    time_stops = abs(math.log2(one.exposure_time_us / other.exposure_time_us))
    return time_stops + abs(one.gain_db - other.gain_db) / DB_PER_STOP
