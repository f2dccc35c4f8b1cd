"""Which cameras of a rig have a vote on the exposure: not one that shows nothing while the others see well."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.metric_map.glance import Glance, glance_at
from autoexpose_daemon.control.policy import MISSED_FRAMES, Look
from calibration.response import ResponseFunction
from drivers.frames import Side

VISIBLE = 1 / 8
"""Share of full scale: the 99th percentile from which a camera that was black shows something again. Three stops are a
distance over which a compromise can be found; nearer to `FAINT` a camera that is 5 stops darker would come and go."""

NOT_WHITE_SHARE = 0.7
"""Saturated share below which a white camera shows something again."""

GLARE_FRAMES = 30
"""Frames that a camera may be white beside another that is not, half a second at 60 Hz, before a look at less exposure
has to show which of the two must win: a moving robot's glance into the sun is over by then."""

LOWEST_STOPS = 0.5
"""The lowest exposure counts as reached within this; quantisation and a forecast may keep the last bit out of reach."""

LONGEST_RISE = 1.0
"""Stops over which frames are compared. A picture in which they promise less than `TELLING_GREY` is all but black."""

REPEATS, FEWEST_PIXELS = 12, 30
"""Frames that repeat an earlier one to the last pixel, while another camera's differ. Noise does not repeat, except in
the few pixels of a small region."""

RETURN_FRAMES = 12
"""Frames in a row that must show something before a vote returns: a fifth of a second at 60 Hz."""

UNHEARD_FRAMES = 60
"""Lone frames of a camera without a vote that are ignored, a second at 60 Hz; then it counts as the only camera."""

Fault = Literal["black", "white", "frozen"]

REMARKS: dict[Fault, str] = {
    "black": "shows nothing, not counted",
    "white": "is white at any exposure, not counted",
    "frozen": "shows the same image at any exposure, not counted",
}
"""What the user reads, after the name of the camera."""


@dataclass(slots=True)
class Eye:
    """What is known of one camera.

    Attributes
    ----------
    fault
        Why it has no vote; None: it has one.
    suspected
        What the last frame spoke for; one alone may be damaged, or taken before a late write.
    showing
        Frames in a row that spoke against the fault.
    glare
        Frames in a row that were white while another camera's were not.
    repeats
        Frames in a row that were exactly `latest`, while another camera's picture changed.
    missed
        Frames in a row that were lost, while another camera's were not.
    before
        Pixels to compare with: for a frozen camera those it is stuck at, else those at the level `Votes` remembers.
        None before the first pair.
    latest
        Pixels of its last frame.
    """

    STATE: ClassVar[tuple[str, ...]] = (
        "fault", "suspected", "showing", "glare", "repeats", "missed", "before", "latest",
    )  # fmt: skip

    fault: Fault | None = None
    suspected: Fault | None = None
    showing: int = 0
    glare: int = 0
    repeats: int = 0
    missed: int = 0
    before: NDArray[np.uint8] | None = None
    latest: NDArray[np.uint8] | None = None


class Votes:
    """Takes the vote from a camera that shows nothing, and gives it back when it does.

    Cameras are judged against each other, frame by frame; only glare asks for exposures of its own. One is

    - black, if it shows nearly nothing while another sees well: a capped lens, or a picture so much darker that one of
      the two must win, which is the brighter, since it needs less gain and a shorter time;
    - white, if it is saturated at the lowest exposure while another is not;
    - frozen, if its picture stays the same while exposure and another camera's picture change, or if it repeats its
      last picture to the pixel while another's changes.

    So a pair whose frames agree, however dark or bright, keeps both votes, and a rig with one camera keeps its one. At
    least one camera of a pair has a vote.

    Parameters
    ----------
    responses
        Response function of each camera.
    """

    STATE: ClassVar[tuple[str, ...]] = ("_eyes", "_before_level", "_unheard")
    _eyes: dict[Side, Eye]
    _before_level: float
    _unheard: int

    def __init__(self, responses: Mapping[Side, ResponseFunction]) -> None:
        self._eyes = {side: Eye() for side in responses}
        self._before_level = 0.0
        self._unheard = 0

    @property
    def faults(self) -> dict[Side, Fault]:
        """The cameras without a vote, and why."""
        return {side: eye.fault for side, eye in self._eyes.items() if eye.fault is not None}

    def see(self, level: float, lowest_level: float, looks: Sequence[Look]) -> None:
        """The frames of one trigger, taken at `level`, when exposure can go down to `lowest_level` (stops)."""
        rise = level - self._before_level
        glances = {look.side: glance_at(look, self._eyes[look.side].before, rise) for look in looks}
        voting = [side for side in glances if self._eyes[side].fault is None]
        for side, eye in self._eyes.items():
            if side not in glances:
                eye.suspected, eye.glare, eye.repeats, eye.missed = None, 0, 0, eye.missed + 1
                continue
            eye.missed = 0
            others = [glances[other] for other in voting if other != side]
            fault = _fault(glances[side], others, at_lowest=level < lowest_level + LOWEST_STOPS)
            self._note(eye, fault, glances[side])
            self._count_repeats(side, glances)
            self._count_glare(side, glances, others)
        for side, glance in glances.items():
            self._eyes[side].latest = glance.pixels
        if len(looks) > 1:
            self._compare_from_here(level, glances)
        self._hear(list(glances))

    @property
    def undecided(self) -> bool:
        """Whether the next frame will show if a camera loses its vote: exposure should stay until then."""
        return any(eye.suspected is not None and eye.fault is None for eye in self._eyes.values())

    @property
    def glaring(self) -> Side | None:
        """A camera with a vote that has long been white while another was not: only lower exposures can show why."""
        return next((side for side, eye in self._eyes.items() if eye.fault is None and eye.glare >= GLARE_FRAMES), None)

    def awaits(self, sides: Collection[Side]) -> bool:
        """Whether one of these cameras has a vote, but has just lost a frame: the next pair will have it again."""
        eyes = [self._eyes[side] for side in sides]
        return any(eye.fault is None and 0 < eye.missed <= MISSED_FRAMES for eye in eyes)

    def of(self, looks: Sequence[Look]) -> list[bool]:
        """Which of the cameras have a vote; none for lone frames that are ignored so far."""
        return [self._eyes[look.side].fault is None for look in looks]

    def remark(self) -> str:
        """A clause on the cameras without a vote, for the reason of a decision; empty if all have one."""
        return "".join(f"; {side} camera {REMARKS[fault]}" for side, fault in self.faults.items())

    def _note(self, eye: Eye, fault: Fault | None, glance: Glance) -> None:
        if fault is not None and fault == eye.suspected:
            eye.fault, eye.showing = fault, 0
        elif eye.fault is not None:
            eye.showing = eye.showing + 1 if _speaks_against(eye.fault, glance) else 0
            if eye.showing >= RETURN_FRAMES:
                eye.fault, eye.showing, eye.before = None, 0, None
        eye.suspected = fault

    def _count_repeats(self, side: Side, glances: Mapping[Side, Glance]) -> None:
        """Finds a frozen camera even if exposure does not move because of it.

        Another camera that was found black beside its old picture gets its vote back.
        """
        eye, glance = self._eyes[side], glances[side]
        others = [each for each in glances if each != side]
        repeated = VISIBLE < glance.median < 1 and self._repeats(side, glance)
        if repeated and any(glances[each].changed or not self._repeats(each, glances[each]) for each in others):
            eye.repeats += 1
        else:
            eye.repeats = 0
        if eye.repeats >= REPEATS and any(self._eyes[each].fault in {None, "black"} for each in others):
            eye.fault, eye.before = "frozen", glance.pixels
        if eye.fault == "frozen":
            for each in glances:
                if self._eyes[each].fault == "black":
                    self._eyes[each] = Eye()

    def _repeats(self, side: Side, glance: Glance) -> bool:
        """Whether a frame equals the one before it, to the last pixel."""
        latest = self._eyes[side].latest
        if latest is None or latest.shape != glance.pixels.shape or latest.size < FEWEST_PIXELS:
            return False
        return bool((latest == glance.pixels).all())

    def _count_glare(self, side: Side, glances: Mapping[Side, Glance], others: Sequence[Glance]) -> None:
        """After the look at less exposure that long glare asks for, a camera that is too dark there must give way."""
        eye, glance = self._eyes[side], glances[side]
        if self.glaring == side and not glance.white and glance.bright >= VISIBLE:
            for each, other in glances.items():
                if each != side and other.bright < VISIBLE:
                    self._eyes[each].fault = "black"
        eye.glare = eye.glare + 1 if glance.white and any(not other.white for other in others) else 0

    def _compare_from_here(self, level: float, glances: Mapping[Side, Glance]) -> None:
        """Compare the next frames with these, once the last comparison has shown what it can.

        All cameras at once: over the same time, light that cancels a change of exposure cancels it for all of them.
        """
        if any(self._eyes[side].fault is None and self._eyes[side].suspected == "frozen" for side in glances):
            return
        compared = {side: glance for side, glance in glances.items() if self._eyes[side].fault != "frozen"}
        known = all(self._eyes[side].before is not None for side in compared)
        told = all(glance.telling for glance in compared.values())
        if told or not known or abs(level - self._before_level) >= LONGEST_RISE:
            self._before_level = level
            for side, glance in compared.items():
                self._eyes[side].before = glance.pixels

    def _hear(self, sides: list[Side]) -> None:
        """If only cameras without a vote have sent frames for long, nobody else is left to decide."""
        unheard = all(self._eyes[side].fault is not None for side in sides)
        self._unheard = self._unheard + 1 if unheard else 0
        if self._unheard >= UNHEARD_FRAMES:
            self._unheard = 0
            for side in sides:
                self._eyes[side] = Eye()


def _fault(glance: Glance, others: Sequence[Glance], *, at_lowest: bool) -> Fault | None:
    """What is wrong with a camera, compared with others that have a vote."""
    if any(other.outshines(glance) for other in others):
        return "black"
    if glance.white and at_lowest and any(not other.white for other in others):
        return "white"
    if glance.stuck and any(other.responsive for other in others):
        return "frozen"
    return None


def _speaks_against(fault: Fault, glance: Glance) -> bool:
    match fault:
        case "black":
            return glance.bright >= VISIBLE
        case "white":
            return glance.saturated_share < NOT_WHITE_SHARE
        case "frozen":
            return glance.changed
