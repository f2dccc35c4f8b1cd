"""The frames of one camera, numbered and timed by three witnesses: counter, time stamps and arrival."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from drivers.camera import IncompleteFrame
from drivers.genicam.nodes import NodeMap
from imaging.frames import ClockTrouble, ClockTroubleKind

LATCH_ERROR_NS = 1_000_000
"""A latch that had to wait for the processor may be off by this much: not a jump."""
OUT_OF_ORDER_NS = 100_000_000
"""A frame given up late may arrive after newer ones: not a jump either."""
SLACK_NS = 1_000_000_000
"""How much earlier than the last frame a new reading of the clock may put this one: that was placed by its arrival."""
SURE_FRAMES = 5
"""One of this many arrives undelayed unless the machine is very busy; a late one would look like the next trigger's."""
COMPARED_DELAYS = 60
"""Delays of frames whose time stamps were believed."""
ARRIVAL_WINDOW = 600
"""Frames whose delays are compared without a latch: 10 s at 60 Hz; crystals of 50 ppm drift by 0.5 ms in it."""
LONG_PAUSE_NS = 10_000_000_000
"""Between two frames: after it, the delays before it are not compared, as the crystals have drifted meanwhile."""
JUDGED_STEPS = 16
"""From frame to frame. While `SURE_FRAMES` of them were wrong, time stamps are not believed."""
SHORT_PERIODS = 0.75
"""Several frames take longer than this part of their periods."""
NEAR = 0.25
"""A mean of arrivals, which scatter, within this part of the configured period is no other rate."""
FOLLOWED = 0.2
"""Of the lateness of frames that are placed by their arrival."""

JUMP_NS = 500_000_000
"""A clock that moves this much against the host's has jumped; what is less is corrected without a word."""
CYCLE = 0xFFFF
"""GigE Vision 1 counts frames 1 ... 65535 and skips 0, so ids repeat after 65535 frames and not 65536."""


@dataclass(frozen=True, slots=True)
class Placed:
    """Where a frame belongs; attributes as those of `Frame`. No host time: it is unknown."""

    frame_id: int
    host_time_ns: int | None
    device_time_ns: int
    by_arrival: bool = False
    clock_trouble: ClockTrouble | None = None

    @property
    def incomplete(self) -> IncompleteFrame:
        """The frame as one whose image is useless; a time that is late is none that it can be paired by."""
        return IncompleteFrame(self.frame_id, None if self.by_arrival else self.host_time_ns)


@dataclass(frozen=True, slots=True)
class _Seen:
    """A frame as it came: its counter, its time stamp, its arrival, and when its exposure ended if that was at once."""

    counter: int
    stamp_ns: int
    arrival_ns: int
    ended_ns: int


@dataclass(frozen=True, slots=True)
class _Last:
    """The newest frame: as it came, and where it was placed."""

    seen: _Seen
    frame_id: int
    device_time_ns: int
    host_ns: int


class FrameTimeline:
    """Places the frames of one camera, in the order of their arrival. Times are in ns; host times are CLOCK_MONOTONIC.

    A frame whose time stamp is contradicted by counter and arrival keeps the place that follows from the frame before
    it. If the arrival does not confirm that place, because the frame is late or a trigger was ignored, the frame's time
    is unknown. While many time stamps are wrong, frames follow one another as counted, at the pace of the quickest
    arrivals.

    Parameters
    ----------
    period_ns
        Period of the triggers, or of the free run, as configured; None: unknown.
    offset_ns
        Host time minus the camera's, as read; None: the camera's clock cannot be read. Then the quickest recent frame
        is assumed to have arrived at the end of its exposure, and times are late by the shortest readout and transfer.
    tick_ns
        Of the camera's clock.
    stamped
        Whether its frames have time stamps at all.
    """

    def __init__(
        self, period_ns: float | None, offset_ns: int | None, tick_ns: float = 1.0, *, stamped: bool = True
    ) -> None:
        self._period_ns = period_ns
        self._wrap_ns = round(tick_ns * 2**32)
        self._wrapped_ns = 0  # so often that
        self._read_ns = offset_ns  # at the latest reading of the clock, until it is used
        self._offset_ns = 0  # host time minus time stamp
        self._offsets_ns: deque[int] | None = deque(maxlen=ARRIVAL_WINDOW)  # None: the offset is read, not inferred
        self._last: _Last | None = None
        self._unsure = False  # whether the newest place still has to be confirmed by an arrival
        self._stamped = stamped
        self._wrong: deque[bool] = deque(maxlen=JUDGED_STEPS)  # of the latest time stamps
        self._jump_ns = 0  # of the latest time stamps that were wrong, until it is known whether the clock goes on
        self._paces_ns: deque[float] = deque(maxlen=JUDGED_STEPS)
        self._usual_ns: deque[int] = deque(maxlen=COMPARED_DELAYS)  # from the end of exposure to arrival
        self._delays_ns: deque[int] = deque(maxlen=JUDGED_STEPS)  # the same, of all the latest frames
        self._misread = 0  # readings of the clock in a row that contradict time stamps and arrivals
        self._said: set[str] = set()
        self._clock_troubles: deque[ClockTrouble] = deque()

    def read(self, offset_ns: int) -> None:
        """The camera's clock was read again: host time minus its time. Any thread."""
        if self._stamped:
            self._read_ns = offset_ns

    @property
    def by_arrival(self) -> bool:
        """Whether the newest frame's time is late by readout and transfer: that of its arrival, less its exposure."""
        return self._offsets_ns is not None

    def place(self, counter: int, stamp_ns: int, arrival_ns: int, exposure_ns: int = 0) -> Placed:
        """Place the next frame, which arrived at `arrival_ns`; its exposure took `exposure_ns`."""
        last = self._last
        counted = 1 if last is None else _counted(counter, last.seen.counter)
        stamp_ns = self._unwrapped(stamp_ns, max(counted, 1))
        seen = _Seen(counter, stamp_ns, arrival_ns, arrival_ns - exposure_ns)
        if last is None:
            return self._begin(seen)
        if counted < 0 and -OUT_OF_ORDER_NS <= stamp_ns - last.seen.stamp_ns < 0:  # it arrives after a newer one
            return Placed(last.frame_id + counted, stamp_ns + self._offset_ns, stamp_ns, self.by_arrival)
        host_ns = self._by_stamp(last, seen, max(counted, 1))
        self._wrong.append(host_ns is None)
        if host_ns is None or self._distrusts_stamps:
            counted, host_ns = self._by_arrival(last, seen, counted)
            self._unsure, told = True, False
        else:
            counted, told = self._believed(last, seen, counted, host_ns), True
        confirmed_ns = self._confirmed(host_ns, seen.ended_ns)
        host_ns = host_ns if confirmed_ns is None else confirmed_ns
        passed_ns = host_ns - last.host_ns
        self._map(seen, host_ns)
        if told:
            self._usual_ns.append(self._delays_ns[-1])
            self._tell_jump()
        else:
            self._jump_ns += seen.stamp_ns - last.seen.stamp_ns - passed_ns
            self._tell_distrust(last, seen)
        self._paces_ns.append((passed_ns if told else arrival_ns - last.seen.arrival_ns) / counted)
        device_time_ns = stamp_ns if told else last.device_time_ns + passed_ns
        self._last = _Last(seen, last.frame_id + counted, device_time_ns, host_ns)
        trouble = self._clock_troubles.popleft() if self._clock_troubles and confirmed_ns is not None else None
        return Placed(self._last.frame_id, confirmed_ns, device_time_ns, self.by_arrival, trouble)

    @property
    def _distrusts_stamps(self) -> bool:
        return not self._stamped or self._wrong.count(True) >= SURE_FRAMES

    @property
    def _usual_delay_ns(self) -> int:
        return min(self._usual_ns) if len(self._usual_ns) >= SURE_FRAMES else 0

    @property
    def _pace_ns(self) -> float | None:
        """How long a frame takes at present, without the longest pause: as configured, if it is near that."""
        if len(self._paces_ns) < SURE_FRAMES:
            return self._period_ns
        pace_ns = (sum(self._paces_ns) - max(self._paces_ns)) / (len(self._paces_ns) - 1)
        near = self._period_ns is not None and abs(pace_ns / self._period_ns - 1) < NEAR
        return self._period_ns if near else pace_ns

    @property
    def _shortest_ns(self) -> float:
        """How long a frame takes at least, for all that is known."""
        return min(self._period_ns or 0.0, self._pace_ns or 0.0)

    def _begin(self, seen: _Seen) -> Placed:
        host_ns = seen.ended_ns
        if self._read_ns is not None:
            by_clock_ns, self._read_ns = seen.stamp_ns + self._read_ns, None
            if host_ns - SLACK_NS <= by_clock_ns <= seen.arrival_ns + LATCH_ERROR_NS:
                host_ns, self._offsets_ns = by_clock_ns, None
                self._usual_ns.append(seen.ended_ns - host_ns)
            else:
                self._misread = 1
        self._map(seen, host_ns)
        self._last = _Last(seen, seen.counter, seen.stamp_ns, host_ns)
        return Placed(seen.counter, host_ns, seen.stamp_ns, self.by_arrival)

    def _unwrapped(self, stamp_ns: int, counted: int) -> int:
        """A time stamp of 32 bits, continued when it starts again."""
        stamp_ns += self._wrapped_ns
        last, pace_ns = self._last, self._pace_ns
        if last is None or pace_ns is None or stamp_ns >= last.seen.stamp_ns:
            return stamp_ns
        passed_ns = stamp_ns + self._wrap_ns - last.seen.stamp_ns
        if abs(passed_ns / counted - pace_ns) > pace_ns / 4:
            return stamp_ns
        self._wrapped_ns += self._wrap_ns
        again = f"start again every {self._wrap_ns * 1e-9:.1f} s"
        self._report("wrap", f"its time stamps have 32 bits and {again}; they are continued")
        return stamp_ns + self._wrap_ns

    def _map(self, seen: _Seen, host_ns: int) -> None:
        """Have time stamps go on from this frame's."""
        if host_ns - seen.stamp_ns != self._offset_ns:
            self._offset_ns = host_ns - seen.stamp_ns
            if self._offsets_ns is not None:
                self._offsets_ns = deque((self._offset_ns,), maxlen=ARRIVAL_WINDOW)

    def _by_stamp(self, last: _Last, seen: _Seen, counted: int) -> int | None:
        """The frame's time by its time stamp; None if counter and arrivals contradict that."""
        read_ns, self._read_ns = self._read_ns, None
        passed_ns, arrived_ns = seen.stamp_ns - last.seen.stamp_ns, seen.arrival_ns - last.seen.arrival_ns
        if passed_ns <= 0 or 4 * passed_ns < counted * self._shortest_ns < 2 * arrived_ns:
            return None
        if read_ns is not None and not self._distrusts_stamps:
            self._take_reading(last, seen, read_ns)
        if self._offsets_ns is not None and arrived_ns > LONG_PAUSE_NS:
            self._offsets_ns.clear()
        elif seen.stamp_ns + self._offset_ns > seen.arrival_ns + LATCH_ERROR_NS:
            return None
        if self._offsets_ns is not None:
            self._offsets_ns.append(seen.ended_ns - seen.stamp_ns)
            self._offset_ns = min(self._offsets_ns)
        return seen.stamp_ns + self._offset_ns

    def _take_reading(self, last: _Last, seen: _Seen, offset_ns: int) -> None:
        """Map by a reading of the clock, unless that would place the frame after its arrival, or long ago."""
        host_ns = seen.stamp_ns + offset_ns
        if self._wrapped_ns:  # the reading may have as few bits
            host_ns += round((seen.stamp_ns + self._offset_ns - host_ns) / self._wrap_ns) * self._wrap_ns
        if last.host_ns - SLACK_NS <= host_ns <= seen.arrival_ns + LATCH_ERROR_NS:
            self._offset_ns, self._offsets_ns = host_ns - seen.stamp_ns, None
            self._unsure, self._misread = False, 0
            return
        self._misread += 1
        if self._misread > 1:  # one alone may be of a clock that was set after the frame was taken
            self._offsets_ns = self._offsets_ns or deque(maxlen=ARRIVAL_WINDOW)
            apart_s = abs(host_ns - seen.arrival_ns) * 1e-9
            self._report(
                "reading",
                f"its clock, as it is read, and the time stamps of its frames are {apart_s:.3g} s apart: it is not "
                "believed, and frames are placed by their arrival",
            )

    def _by_arrival(self, last: _Last, seen: _Seen, counted: int) -> tuple[int, int]:
        """How many frames went by, and the frame's time, without its time stamp."""
        pace_ns, usual_ns = self._pace_ns, self._usual_delay_ns
        if len(self._usual_ns) < SURE_FRAMES and self._offsets_ns is None:  # the first ones hardly count
            self._offsets_ns = deque(maxlen=ARRIVAL_WINDOW)
            self._delays_ns.clear()
            return max(counted, 1), seen.ended_ns
        if pace_ns is None:
            return max(counted, 1), seen.ended_ns - usual_ns
        if counted < 1 or seen.ended_ns - last.host_ns - counted * pace_ns < usual_ns - pace_ns / 2:
            counted = max(round((seen.arrival_ns - last.seen.arrival_ns) / pace_ns), 1)
        return counted, last.host_ns + round(counted * pace_ns)

    def _believed(self, last: _Last, seen: _Seen, counted: int, host_ns: int) -> int:
        """How many frames went by: as counted, unless there was no time for so many."""
        shortest_ns, passed_ns = self._shortest_ns, host_ns - last.host_ns
        if counted == 1 or (counted > 1 and passed_ns >= SHORT_PERIODS * counted * shortest_ns):
            return counted
        self._report(
            "counter",
            f"its frame counter went from {last.seen.counter} to {seen.counter} in {passed_ns * 1e-6:.1f} ms, by its "
            "time stamps and the arrival of its frames: where it cannot be right, frames are counted by these",
        )
        return max(round(passed_ns / shortest_ns), 1) if shortest_ns else 1

    def _confirmed(self, host_ns: int, ended_ns: int) -> int | None:
        """The frame's time as its arrival corrects it; None if it is late, or a trigger was ignored: who knows?"""
        self._delays_ns.append(ended_ns - host_ns)
        if not self._unsure:
            return host_ns
        delays_ns, pace_ns, usual_ns = self._delays_ns, self._pace_ns, self._usual_delay_ns
        late_ns = min(delays_ns) - usual_ns
        if pace_ns is not None and late_ns >= -pace_ns / 2:
            newest_ns = list(delays_ns)[-SURE_FRAMES:]
            steady = len(newest_ns) == SURE_FRAMES and max(newest_ns) - min(newest_ns) < pace_ns / 2
            if steady and min(newest_ns) - usual_ns > pace_ns / 2:  # as many triggers were ignored
                late_ns = min(newest_ns) - usual_ns
            elif newest_ns[-1] - usual_ns > pace_ns / 2 and not self._distrusts_stamps:
                return None
            else:
                late_ns = min(late_ns, round(FOLLOWED * late_ns))  # but no frame arrives early
        self._delays_ns = deque((delay_ns - late_ns for delay_ns in delays_ns), maxlen=JUDGED_STEPS)
        self._unsure = False
        return host_ns + late_ns

    def _tell_jump(self) -> None:
        """The clock goes on after time stamps that were wrong."""
        jump_ns, self._jump_ns = self._jump_ns, 0
        if abs(jump_ns) >= JUMP_NS:
            jumped = f"jumped by {jump_ns * 1e-9:+.1f} s"
            self._clock_troubles.append(ClockTrouble("jump", f"its clock {jumped}; its frames keep their place"))

    def _tell_distrust(self, last: _Last, seen: _Seen) -> None:
        if not self._distrusts_stamps:
            return
        self._jump_ns = 0
        if not self._stamped:
            return
        passed_ns, arrived_ns = seen.stamp_ns - last.seen.stamp_ns, seen.arrival_ns - last.seen.arrival_ns
        went = f"went on by {passed_ns * 1e-6:.3g} ms while {arrived_ns * 1e-6:.3g} ms passed"
        how = went if passed_ns else "stand still"
        self._report("stamps", f"its time stamps {how} and are not believed: its frames are placed by their arrival")

    def _report(self, kind: ClockTroubleKind, sentence: str) -> None:
        """Say so, once."""
        if kind not in self._said:
            self._said.add(kind)
            self._clock_troubles.append(ClockTrouble(kind, sentence))


def _counted(counter: int, last: int) -> int:
    """By how many frames the counter went on, or back; if it may have 16 bits, less than half a cycle."""
    if max(counter, last) > CYCLE:
        return counter - last
    cycle = CYCLE + (counter == 0)  # this one does not skip it
    ahead = (counter - last) % cycle
    return ahead if ahead <= cycle // 2 else ahead - cycle


LATCH_TRIES = 5
"""A latch is accurate to half its round trip (0.1 ms on a quiet wire); the quickest of a few is kept."""
NANOSECONDS = 1_000_000_000


class LatchedClock:
    """Latches the camera's clock between two readings of the host's; the offset refers to their midpoint."""

    def __init__(
        self,
        nodes: NodeMap,
        command: str,
        value: str,
        tick_frequency_hz: int,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.tick_ns = NANOSECONDS / tick_frequency_hz
        self._nodes = nodes
        self._command = command
        self._value = value
        self._tick_frequency_hz = tick_frequency_hz
        self._now_ns = now_ns

    def read(self) -> int:
        """Host time minus the camera's (ns); a drift of some ppm moves it by microseconds a second.

        Raises `NodeError` and `CameraLostError`.
        """
        _, offset_ns = min(self._sample() for _ in range(LATCH_TRIES))
        return offset_ns

    def _sample(self) -> tuple[int, int]:
        """Round trip and offset (both ns) of one latch."""
        before_ns = self._now_ns()
        self._nodes.execute(self._command)
        round_trip_ns = self._now_ns() - before_ns
        ticks = int(self._nodes.read(self._value))
        device_ns = ticks * NANOSECONDS // self._tick_frequency_hz
        return round_trip_ns, before_ns + round_trip_ns // 2 - device_ns


def find_clock(nodes: NodeMap) -> tuple[LatchedClock | None, tuple[str, ...]]:
    """The clock that this camera lets the host read, if any, and its limitations in words."""
    if nodes.available("TimestampLatch") and nodes.available("TimestampLatchValue"):
        return LatchedClock(nodes, "TimestampLatch", "TimestampLatchValue", NANOSECONDS), ()
    if not (nodes.available("GevTimestampControlLatch") and nodes.available("GevTimestampValue")):
        return None, ("no time stamp latch: host times are inferred from arrival, late by readout and transfer",)
    tick_frequency_hz = NANOSECONDS
    if nodes.available("GevTimestampTickFrequency"):
        tick_frequency_hz = int(nodes.read("GevTimestampTickFrequency")) or NANOSECONDS
    return LatchedClock(nodes, "GevTimestampControlLatch", "GevTimestampValue", tick_frequency_hz), ()
