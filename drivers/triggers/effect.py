"""Whether frames are taken with what was written: a camera may acknowledge a write, read it back and ignore it."""

from __future__ import annotations

from drivers.triggers.history import WriteHistory
from imaging.frames import Frame

PATIENCE_NS = 500_000_000
"""The slowest camera reported takes 0.4 s from write to effect."""

SUSPECT_FRAMES = 20
"""This many in a row: single frames may fall between the writes of time and gain, or be under way."""


class EffectWatch:
    """Compares the frames of one camera with what its nodes read back.

    Attributes
    ----------
    frames_off_setting
        Frames, twenty or more in a row, taken with a setting that was not written within the last half second.
    """

    def __init__(self) -> None:
        self.frames_off_setting = 0
        self._in_a_row = 0
        self._trouble: str | None = None

    def frame(self, frame: Frame, history: WriteHistory) -> str | None:
        """What is wrong with the camera as of this frame, in words; None: nothing."""
        if frame.setting_source != "chunk":
            return None
        held = history.held_since(frame.host_time_ns - PATIENCE_NS)
        if held is None:
            return None
        if any(frame.setting.agrees_with(setting) for setting in held):
            self._in_a_row, self._trouble = 0, None
            return None
        self._in_a_row += 1
        if self._in_a_row > SUSPECT_FRAMES:
            self.frames_off_setting += 1
        elif self._in_a_row == SUSPECT_FRAMES:
            self.frames_off_setting += SUSPECT_FRAMES
            self._trouble = (
                f"its frames do not follow what is written: its nodes hold {held[0]}, "
                f"frames are taken with {frame.setting}; switch the camera off and on"
            )
        return self._trouble

    def gone(self) -> None:
        """The camera is lost."""
        self._in_a_row, self._trouble = 0, None
