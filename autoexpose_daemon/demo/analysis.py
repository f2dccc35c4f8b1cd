"""A demo run compared with the pulses on the fakes' trigger wire, in figures for programs and in words."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from rich.text import Text

from autoexpose_daemon.control.picture.image import Shrinking
from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.demo.fakes import FakeCamera, Pulse
from autoexpose_daemon.demo.options import DemoOptions
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.status.counters import DURATIONS, Counts, unusual_counts
from autoexpose_daemon.status.panel import lost_in_words
from drivers.triggers.outcomes import MISSING, LossReason, Tally
from imaging.exposure import ExposureSetting

_PICTURE_WIDTH = 180


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One control step: when and how the first camera took its frame, what of it is lost, and the decision."""

    trigger: int
    host_time_ns: int
    applied: ExposureSetting
    decided_level: float
    saturated_share: float
    black_share: float
    reason: str


class StepLog:
    """Observes the daemon's steps: one record for each decision, and small pictures of the first camera by their times.

    `pairs_ns` says when the first frames of all complete sets were taken, decided on or not (CLOCK_MONOTONIC).
    """

    def __init__(self, picture_period_s: float, cameras: int = 2) -> None:
        self.steps: list[StepRecord] = []
        self.pairs_ns: list[int] = []
        self.pictures: list[tuple[int, NDArray[np.uint8]]] = []
        self._cameras = cameras
        self._picture_period_ns = picture_period_s * 1e9

    def __call__(self, step: ControlStep) -> None:
        """Keep a step; a pair without a decision only counts as a pair."""
        pair, decision, frame = step.pair, step.decision, step.pair.reference
        if len(pair.frames) == self._cameras:
            self.pairs_ns.append(frame.host_time_ns)
        if decision is None:
            return
        self.steps.append(
            StepRecord(
                pair.trigger,
                frame.host_time_ns,
                frame.setting,
                decision.level,
                decision.saturated_share,
                decision.black_share,
                decision.reason,
            )
        )
        if not self.pictures or frame.host_time_ns - self.pictures[-1][0] >= self._picture_period_ns:
            grey = frame.grey8()
            size = (_PICTURE_WIDTH, round(grey.shape[0] * _PICTURE_WIDTH / grey.shape[1]))
            self.pictures.append((frame.host_time_ns, Shrinking(grey.shape, size).shrink(grey)))


_STEP_STOPS = 0.5  # a change of light by this much between two pulses is a step, not a ramp or beating flicker
_SETTLED_STOPS = 0.25
_SETTLED_FRAMES = 10
_REFERENCE_FRAMES = 20
_LARGEST_CLIPPED_SHARE = 0.5
_DECIDED_STOPS = 0.5
_REALISED_STOPS = 0.05
_LONGEST_DELAY_FRAMES = 30


@dataclass(frozen=True, slots=True)
class LightStep:
    """A step of the light, and after how many frames the exposure was steady and had settled.

    None: not before the next step. `mostly` is the reason that the policy gave most often until then.
    """

    time_s: float
    from_lux: float
    to_lux: float
    frames_to_steady: int | None
    frames_to_settle: int | None
    mostly: str

    def in_words(self, rate_hz: float) -> str:
        """How soon the exposure followed, in words; that it goes on to follow the view is no news."""
        frames = [each for each in (self.frames_to_steady, self.frames_to_settle) if each is not None]
        if not frames:
            return f"not steady before the next step (mostly: {self.mostly})"
        noun = "frame" if frames[0] == 1 else "frames"
        return f"well exposed and steady after {frames[0]} {noun} ({1e3 * frames[0] / rate_hz:.0f} ms)"


@dataclass(frozen=True, slots=True)
class LightSetting:
    """A level of the light, and the median settings of the frames taken under it."""

    lux: float
    exposure_time_us: float
    gain_db: float


def pulses_in_window(pulses: Sequence[Pulse], tally: Tally) -> list[Pulse]:
    """The pulses within the window that the daemon accounts for."""
    if tally.window_start_ns is None or tally.window_end_ns is None:
        return []
    return [pulse for pulse in pulses if tally.window_start_ns <= pulse.host_time_ns < tally.window_end_ns]


def lost_pulses(pulses: Sequence[Pulse], pairs_ns: Sequence[int]) -> list[int]:
    """Times of the pulses between the first and the last pair that made no pair."""
    if len(pulses) < 2 or not pairs_ns:
        return []
    half_ns = (pulses[1].host_time_ns - pulses[0].host_time_ns) // 2
    taken_ns = sorted(pairs_ns)
    lost = []
    for pulse in pulses:
        before = bisect_left(taken_ns, pulse.host_time_ns - half_ns)
        made = before < len(taken_ns) and taken_ns[before] <= pulse.host_time_ns + half_ns
        if not made and taken_ns[0] < pulse.host_time_ns < taken_ns[-1]:
            lost.append(pulse.host_time_ns)
    return lost


def light_steps(pulses: Sequence[Pulse], records: Sequence[StepRecord]) -> list[LightStep]:
    """Every step of the light that is followed by enough frames to judge it."""
    changes = [
        (before, after)
        for before, after in pairwise(pulses)
        if abs(np.log2(max(after.lux, 1e-6) / max(before.lux, 1e-6))) > _STEP_STOPS
    ]
    ends_ns = [before.host_time_ns for before, _ in changes[1:]] + [pulses[-1].host_time_ns + 1] if changes else []
    steps = []
    for (before, after), end_ns in zip(changes, ends_ns, strict=True):
        # the light changed between the two pulses: the later frame was exposed entirely after it
        between_ns = (before.host_time_ns + after.host_time_ns) // 2
        following = [record for record in records if between_ns < record.host_time_ns <= end_ns]
        if len(following) >= _REFERENCE_FRAMES + _SETTLED_FRAMES:
            time_s = (after.host_time_ns - pulses[0].host_time_ns) * 1e-9
            mostly = Counter(record.reason for record in following).most_common(1)[0][0]
            # Control may have skipped the first frames after the step: they count.
            skipped = round(
                (following[0].host_time_ns - after.host_time_ns) / (after.host_time_ns - before.host_time_ns)
            )
            steady, settled = (
                None if frames is None else frames + skipped
                for frames in (frames_to_steady(following), frames_to_settle(following))
            )
            steps.append(LightStep(round(time_s, 3), before.lux, after.lux, steady, settled, mostly))
    return steps


def light_settings(pulses: Sequence[Pulse], records: Sequence[StepRecord]) -> list[LightSetting]:
    """The settings under each constant level of the light, in order; ramps are left out."""
    times_ns = [pulse.host_time_ns for pulse in pulses]
    taken: dict[float, list[ExposureSetting]] = {pulse.lux: [] for pulse in pulses}
    for record in records:
        after = bisect_left(times_ns, record.host_time_ns)
        near = pulses[max(after - 1, 0) : after + 1]  # the pulse before and the one after
        if near:
            pulse = min(near, key=lambda pulse: abs(pulse.host_time_ns - record.host_time_ns))
            taken[pulse.lux].append(record.applied)
    return [
        LightSetting(
            lux,
            round(float(np.median([setting.exposure_time_us for setting in settings])), 1),
            round(float(np.median([setting.gain_db for setting in settings])), 2),
        )
        for lux, settings in taken.items()
        if len(settings) >= _REFERENCE_FRAMES
    ]


def frames_to_settle(following: Sequence[StepRecord]) -> int | None:
    """Frames until the first of 10 in a row whose level is within 0.25 stops of where it ends, most of them unclipped.

    Where it ends is the median level of the last 20 frames: a view that moves on meanwhile counts as not settled yet.
    Frames are counted by their triggers, lost ones included.
    """
    end = float(np.median([record.applied.level for record in following[-_REFERENCE_FRAMES:]]))
    return _first_of_ten_near(following, lambda _: end)


def frames_to_steady(following: Sequence[StepRecord]) -> int | None:
    """Frames until the first of 10 in a row whose levels are within 0.25 stops of the first one's, mostly unclipped."""
    return _first_of_ten_near(following, lambda first: first.applied.level)


def _first_of_ten_near(following: Sequence[StepRecord], level: Callable[[StepRecord], float]) -> int | None:
    def shows_near(record: StepRecord, level: float) -> bool:
        clipped_share = record.saturated_share + record.black_share
        return clipped_share < _LARGEST_CLIPPED_SHARE and abs(record.applied.level - level) <= _SETTLED_STOPS

    for index in range(len(following) - _SETTLED_FRAMES + 1):
        ten = following[index : index + _SETTLED_FRAMES]
        complete = ten[-1].trigger - ten[0].trigger == _SETTLED_FRAMES - 1
        if complete and all(shows_near(record, level(ten[0])) for record in ten):
            return ten[0].trigger - following[0].trigger
    return None


def delay_frames(records: Sequence[StepRecord]) -> int | None:
    """Frames from the decision on a large change to the first frame taken with it: the median, None without any."""
    delays = []
    for index, (before, record) in enumerate(pairwise(records), start=1):
        if abs(record.decided_level - before.decided_level) < _DECIDED_STOPS:
            continue
        for later in records[index + 1 : index + 1 + _LONGEST_DELAY_FRAMES]:
            if abs(later.applied.level - record.decided_level) < _REALISED_STOPS:
                delays.append(later.trigger - record.trigger)
                break
    return round(float(np.median(delays))) if delays else None


_TRANSPORTS = {"gige": "GigE Vision", "usb3": "USB3 Vision"}


@dataclass(frozen=True, slots=True)
class DemoRun:
    """A finished run: how long it took, the daemon's CPU time in it, and the published algorithm's step time here.

    The cameras may have run for longer, for another daemon.
    """

    options: DemoOptions
    rate_hz: float
    daemon: Daemon
    cameras: Sequence[FakeCamera]
    pulses: Sequence[Pulse]
    step_log: StepLog
    took_s: float
    cameras_took_s: float
    daemon_cpu_s: float
    reference_step_ms: float


def figures(run: DemoRun, steps: Sequence[LightStep]) -> dict[str, Any]:
    """The figures of a run, as written to the summary file."""
    tally, telemetry = run.daemon.tally, run.daemon.telemetry
    width, height = run.options.width_height
    seconds = ((tally.window_end_ns or 0) - (tally.window_start_ns or 0)) * 1e-9
    return {
        "transport": run.options.transport,
        "policy": run.options.policy,
        "pixel_format": run.options.pixel_format,
        "width": width,
        "height": height,
        "rate_hz": run.rate_hz,
        "seconds": round(seconds, 3),
        "fps": round(tally.pairs / seconds, 2) if seconds else 0.0,
        "triggers": len(run.pulses),
        "pairs": tally.pairs,
        "lost": {str(reason): count for reason, count in tally.lost.items() if count},
        "cameras": {
            name: {"frames": tally.frames[name], "lost": tally.frames_lost[name]} for name in run.daemon.config.cameras
        },
        "groups": {
            name: {"policy": tally.policy, "decision_ms": tally.decision_ms.percentiles()}
            for name, tally in telemetry.groups.items()
        },
        "fakes": {
            "overruns": sum(camera.overruns for camera in run.cameras),
            "cpu_percent": [round(100 * camera.cpu_s / run.cameras_took_s, 1) for camera in run.cameras],
        },
        "counts": asdict(telemetry.counts),
        "steps": [{name: value for name, value in asdict(step).items() if name != "mostly"} for step in steps],
        "settings": [asdict(setting) for setting in light_settings(run.pulses, run.step_log.steps)],
        **{duration.field: getattr(telemetry, duration.field).percentiles() for duration in DURATIONS},
        "published": None if telemetry.publishing is None else telemetry.publishing.sent,
        "delay_frames": delay_frames(run.step_log.steps),
        "first_trigger": run.pulses[0].trigger if run.pulses else None,
        "daemon_cpu_percent": round(100 * run.daemon_cpu_s / run.took_s, 1),
        "reference_step_ms": round(run.reference_step_ms, 3),
    }


def in_words(figures: Mapping[str, Any], steps: Sequence[LightStep]) -> Table:
    """The figures in words, with units."""
    table = Table.grid(padding=(0, 3))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in _rows(figures, steps):
        table.add_row(Text(name), Text(text))
    return table


def _rows(figures: Mapping[str, Any], steps: Sequence[LightStep]) -> Iterator[tuple[str, str]]:
    for step in steps:
        followed = step.in_words(figures["rate_hz"])
        yield f"light at {step.time_s:.1f} s", f"{step.from_lux:g} to {step.to_lux:g} lux: {followed}"
    for setting in figures["settings"]:
        chosen = f"{setting['exposure_time_us'] / 1e3:.2f} ms of exposure, {setting['gain_db']:.1f} dB of gain"
        yield f"under {setting['lux']:g} lux", f"{chosen} (medians)"
    sets = "stereo pairs" if len(figures["cameras"]) == 2 else "sets of frames"
    pairs = f"{figures['pairs']} {sets} in {figures['seconds']:.1f} s, {figures['fps']:.1f} per second"
    kind = f"{figures['pixel_format']} {figures['width']}x{figures['height']}"
    count = len(figures["cameras"])
    cameras = f"{count} fake {_TRANSPORTS[figures['transport']]} camera{'s' if count > 1 else ''}"
    yield "seen", f"{pairs}, from {cameras}, {kind}"
    yield "lost", f"{_lost(figures)}; of {figures['triggers']} triggers on the cameras' wire"
    unusual = dict(unusual_counts(Counts(**figures["counts"])))
    if unusual:
        counted = ", ".join(f"{counter.label}: {count}" for counter, count in unusual.items())
        yield "anomalies", counted + _why({counter.name: count for counter, count in unusual.items()}, figures)
    if figures["published"] is not None:
        yield "published", f"{figures['published']} {sets}, for other processes"
    yield from _delays(figures)
    fakes = " and ".join(f"{percent:.0f} %" for percent in figures["fakes"]["cpu_percent"])
    yield "processor", f"daemon {figures['daemon_cpu_percent']:.0f} % of a core, fakes {fakes}"


def _delays(figures: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The durations that a user can compare with the time between two frames; the summary file has all."""
    to_node, to_effect = figures["frame_to_node_ms"], figures["command_to_effect_ms"]
    if to_node["p50"] is not None:
        late = f" (99 of 100 within {to_node['p99']:.1f} ms)"
        between = f"frames come every {1e3 / figures['rate_hz']:.1f} ms"
        yield "delay", f"{to_node['p50']:.1f} ms from a frame to new settings in the cameras{late}; {between}"
    if to_effect["p50"] is not None:
        yield "effect", f"{to_effect['p50']:.1f} ms from a decision to the first exposure taken with it"


def _why(counts: Mapping[str, int], figures: Mapping[str, Any]) -> str:
    if figures["fakes"]["overruns"]:
        return _BUSY
    if counts.keys() - _OF_DELAYS or max(counts.values()) > _FEW * figures["pairs"]:
        return "; what to do: docs/look-up/faults.md, docs/do/busy-machines.md"
    return "; up to one in a hundred is normal, when other programs want the processor, too"


_OF_DELAYS = {"pairs_without_decision", "late_writes"}
_FEW = 0.01  # of all pairs
_BUSY = "; to be expected, because this machine was too busy for the fake cameras"
_SEVERAL = {LossReason.BOTH_MISSING: 2, LossReason.SEVERAL_MISSING: 2}  # frames, at least


def _lost(figures: Mapping[str, Any]) -> str:
    """The losses, and how many of the missing frames the simulation failed to send in time."""
    lost = figures["lost"]
    one = [reason for reason in lost if reason.endswith(MISSING) and reason not in _SEVERAL]
    frames = sum(lost.get(reason, 0) for reason in (*one, LossReason.TRIGGER_IGNORED))
    frames += sum(count * lost.get(reason, 0) for reason, count in _SEVERAL.items())
    late = min(figures["fakes"]["overruns"], frames)
    return lost_in_words(lost, f" ({late} of these frames because a fake camera was late)" if late else "")
