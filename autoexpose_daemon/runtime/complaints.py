"""What is wrong with the cameras just now: each thing is said when it begins, and shows until it is over."""

from __future__ import annotations

import logging

from drivers.frames import Side

log = logging.getLogger(__name__)

Kind = str
"""What kind of trouble, such as "refused": of each a camera has one at a time."""


class Complaints:
    """Keeps the complaints of a rig; `present` is read by other threads."""

    def __init__(self, present: dict[tuple[Side, Kind], str]) -> None:
        self.present = present
        self._said: set[tuple[Side, Kind, str]] = set()

    def begin(self, side: Side, kind: Kind, sentence: str) -> None:
        """Something is wrong: it is logged when it begins, not at every repetition."""
        if (side, kind) not in self.present:
            self._say(side, kind, sentence)

    def change(self, side: Side, kind: Kind, sentence: str) -> None:
        """The same, where each new sentence tells more."""
        if (side, kind, sentence) not in self._said:
            self._said.add((side, kind, sentence))
            self._say(side, kind, sentence)

    def judge(self, side: Side, kind: Kind, sentence: str | None) -> None:
        """What there is to say now; None: nothing. Another sentence than the last is logged."""
        if sentence is None:
            self.end(side, kind)
        elif self.present.get((side, kind)) != sentence:
            self._say(side, kind, sentence)

    def end(self, side: Side, kind: Kind) -> None:
        """It is over, or never was."""
        if self.present.pop((side, kind), None) is not None:
            self._said = {said for said in self._said if said[:2] != (side, kind)}

    def end_all(self, side: Side) -> None:
        """The camera is another one from now on, or none."""
        for complained, kind in list(self.present):
            if complained == side:
                self.end(side, kind)

    def _say(self, side: Side, kind: Kind, sentence: str) -> None:
        self.present[side, kind] = sentence
        log.warning("%s camera: %s", side, sentence)
