"""A drive that was recorded in brackets, read as often as needed and never held in memory as a whole."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlSetup
from evaluation.rejudge.glimpse import Watcher, delay_frames
from evaluation.rejudge.timeline import REACH, Timeline
from imaging.errors import AutoexposeError
from imaging.frames import Side, StereoPair
from imaging.geometry import CameraGeometry
from imaging.pixels import plane_shape

FEWEST_CYCLES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What is known of a drive after it has been read once.

    Attributes
    ----------
    name
        For people.
    setup
        What control was built from, with `ControlParameters.bracket`.
    source
        Reads its complete pairs from the first to the last; pickles, if it is to go to other processes.
    timeline
        Of these pairs.
    geometries
        Of the calibrated cameras.
    shape
        (height, width) of what `Frame.grey8` gives.
    delay_frames
        A decision showed this many pairs later.
    missing
        Triggers without a complete pair, from the first to the last one.
    """

    name: str
    setup: ControlSetup
    source: Callable[[], Iterator[StereoPair]]
    timeline: Timeline
    geometries: Mapping[Side, CameraGeometry]
    shape: tuple[int, int]
    delay_frames: int
    missing: int

    @property
    def seconds(self) -> float:
        """From the first pair to the last."""
        return self.timeline.glimpses[-1].time_s - self.timeline.glimpses[0].time_s

    def pairs(self) -> Iterator[tuple[int, Callable[[int], StereoPair]]]:
        """Each instant, with a function that gives the pairs that may stand for it, `Timeline.near`."""
        reach = REACH * self.timeline.cycle
        kept: deque[tuple[int, StereoPair]] = deque(maxlen=2 * reach + 1)
        ahead = enumerate(self.source())

        def pair_at(number: int) -> StereoPair:
            return kept[number - kept[0][0]][1]

        for number in range(len(self.timeline.glimpses)):
            while not kept or kept[-1][0] < number + reach:
                entry = next(ahead, None)
                if entry is None:
                    break
                kept.append(entry)
            yield number, pair_at


def watched(
    name: str,
    setup: ControlSetup,
    seen: Iterable[tuple[StereoPair, Decision, float]],
    source: Callable[[], Iterator[StereoPair]],
    geometries: Mapping[Side, CameraGeometry],
) -> Drive:
    """A drive that is read for the first time.

    Parameters
    ----------
    name, setup, source, geometries
        As in `Drive`.
    seen
        What `source` reads, what was decided on each pair, and when it was taken (s).

    Raises
    ------
    AutoexposeError
        For a drive that is too short, or of a pixel format that cannot be exposed again.
    """
    bracket = setup.parameters.bracket
    assert bracket is not None, "a drive in brackets"
    cycle = bracket.exposures + bracket.keep
    watcher, glimpses, shape = Watcher(setup.responses, cycle), [], (0, 0)
    for pair, decision, time_s in seen:
        frame = pair.reference
        if frame.layout == "YUYV":
            raise AutoexposeError(f"{name}: frames of YUV422_8 cannot be exposed again: record Mono, Bayer or RGB8")
        glimpses.append(watcher.look(pair, decision, time_s))
        shape = plane_shape((frame.pixels.shape[0], frame.pixels.shape[1]), frame.layout)
    needed = FEWEST_CYCLES * cycle
    if len(glimpses) < needed:
        raise AutoexposeError(
            f"{name}: has {len(glimpses)} complete pairs: give at least {needed}, {FEWEST_CYCLES} cycles"
        )
    missing = glimpses[-1].trigger - glimpses[0].trigger + 1 - len(glimpses)
    timeline = Timeline.of(glimpses, cycle)
    return Drive(name, setup, source, timeline, geometries, shape, delay_frames(glimpses), max(missing, 0))
