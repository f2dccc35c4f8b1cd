"""Whether frames are taken as was written: a camera may acknowledge, read back right, and expose as it likes."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from drivers.exposure import ExposureSetting
from drivers.frames import Frame, Side

PATIENCE_NS = 500_000_000
"""The slowest camera reported takes 0.4 s from write to effect."""

ASTRAY_FRAMES = 20
"""So many in a row: a frame between the writing of time and gain, or one under way, is no sign."""

_REMEMBERED_WRITES = 128
"""Those of `PATIENCE_NS` at 200 Hz, and the one before."""


@dataclass(slots=True)
class _Camera:
    writes: deque[tuple[int, ExposureSetting]] = field(default_factory=lambda: deque(maxlen=_REMEMBERED_WRITES))
    astray: int = 0
    trouble: str | None = None


class EffectWatch:
    """Holds the frames of each camera against what its nodes read back; times are of the host's clock.

    Attributes
    ----------
    frames_off_setting
        Frames, twenty or more in a row, taken with a setting that was not written within the last half second.
    """

    def __init__(self) -> None:
        self.frames_off_setting = 0
        self._cameras: dict[Side, _Camera] = {}

    def written(self, side: Side, read_back: ExposureSetting, time_ns: int) -> None:
        """A camera's nodes hold this setting since `time_ns`."""
        self._cameras.setdefault(side, _Camera()).writes.append((time_ns, read_back))

    def frame(self, side: Side, frame: Frame) -> str | None:
        """What is wrong with the camera as of this frame, in words; None: nothing."""
        camera = self._cameras.get(side)
        if camera is None or frame.setting_source != "chunk":
            return None
        writes, since_ns = camera.writes, frame.host_time_ns - PATIENCE_NS
        while len(writes) > 1 and writes[1][0] < since_ns:
            writes.popleft()
        if writes[0][0] > since_ns:
            return None  # it may still hold what it held before
        if any(frame.setting.agrees_with(setting) for _, setting in reversed(writes)):
            camera.astray, camera.trouble = 0, None
            return None
        camera.astray += 1
        if camera.astray > ASTRAY_FRAMES:
            self.frames_off_setting += 1
        elif camera.astray == ASTRAY_FRAMES:
            self.frames_off_setting += ASTRAY_FRAMES
            camera.trouble = (
                f"its frames do not follow what is written: {writes[-1][1]} stands in its nodes, "
                f"frames are taken with {frame.setting}; switch the camera off and on"
            )
        return camera.trouble

    def gone(self, side: Side) -> None:
        """Nothing is known of a camera's nodes, until it is written."""
        self._cameras.pop(side, None)
