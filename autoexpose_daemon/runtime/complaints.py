"""What is wrong with the cameras at present: each complaint is logged when it begins, and kept until it is over."""

from __future__ import annotations

import logging

from imaging.frames import Side

log = logging.getLogger(__name__)

Kind = str
"""The kind of trouble, such as "refused"; a camera has one complaint of each kind at a time."""


class Complaints:
    """Keeps the complaints of a rig; `present` is read by other threads."""

    def __init__(self, present: dict[tuple[Side, Kind], str]) -> None:
        self.present = present
        self._logged: set[tuple[Side, Kind, str]] = set()

    def begin(self, side: Side, kind: Kind, sentence: str) -> None:
        """Something is wrong: logged when it begins, not at every repetition."""
        if (side, kind) not in self.present:
            self._log(side, kind, sentence)

    def change(self, side: Side, kind: Kind, sentence: str) -> None:
        """The same, but each new sentence is logged."""
        if (side, kind, sentence) in self._logged:
            self.present[side, kind] = sentence
        else:
            self._logged.add((side, kind, sentence))
            self._log(side, kind, sentence)

    def judge(self, side: Side, kind: Kind, sentence: str | None) -> None:
        """The current verdict; None: nothing is wrong. A new sentence is logged."""
        if sentence is None:
            self.end(side, kind)
        elif self.present.get((side, kind)) != sentence:
            self._log(side, kind, sentence)

    def end(self, side: Side, kind: Kind) -> None:
        """It is over, if it ever began."""
        if self.present.pop((side, kind), None) is not None:
            self._logged = {logged for logged in self._logged if logged[:2] != (side, kind)}

    def end_all(self, side: Side) -> None:
        """The camera is replaced or gone."""
        for complained, kind in list(self.present):
            if complained == side:
                self.end(side, kind)

    def _log(self, side: Side, kind: Kind, sentence: str) -> None:
        self.present[side, kind] = sentence
        log.warning("%s camera: %s", side, sentence)
