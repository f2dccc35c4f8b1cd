"""The figures of a demo run, as data for programs and in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rich.table import Table
from rich.text import Text

from autoexpose_daemon.demo.analysis import LightStep, StepLog, delay_frames, light_settings
from autoexpose_daemon.demo.fakes import FakeCamera, Pulse
from autoexpose_daemon.demo.options import DemoOptions
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.status.counters import DURATIONS, Counts, unusual_counts
from autoexpose_daemon.status.panel import lost_in_words

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
        "fakes": {
            "overruns": sum(camera.overruns for camera in run.cameras),
            "cpu_percent": [round(100 * camera.cpu_s / run.cameras_took_s, 1) for camera in run.cameras],
        },
        "counts": asdict(telemetry.counts),
        "steps": [_step_as_json(step) for step in steps],
        "settings": [asdict(setting) for setting in light_settings(run.pulses, run.step_log.steps)],
        **{duration.field: getattr(telemetry, duration.field).percentiles() for duration in DURATIONS},
        "published": None if telemetry.publishing is None else telemetry.publishing.sent,
        "delay_frames": delay_frames(run.step_log.steps),
        "first_trigger": run.pulses[0].trigger if run.pulses else None,
        "daemon_cpu_percent": round(100 * run.daemon_cpu_s / run.took_s, 1),
        "reference_step_ms": round(run.reference_step_ms, 3),
    }


def _step_as_json(step: LightStep) -> dict[str, float | int | None]:
    keys = ("time_s", "from_lux", "to_lux", "frames_to_steady", "frames_to_settle")
    return {key: getattr(step, key) for key in keys}


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
    pairs = f"{figures['pairs']} stereo pairs in {figures['seconds']:.1f} s, {figures['fps']:.1f} per second"
    kind = f"{figures['pixel_format']} {figures['width']}x{figures['height']}"
    yield "seen", f"{pairs}, from two fake {_TRANSPORTS[figures['transport']]} cameras, {kind}"
    yield "lost", f"{_lost(figures)}; of {figures['triggers']} triggers on the cameras' wire"
    unusual = [f"{counter.label}: {count}" for counter, count in unusual_counts(Counts(**figures["counts"]))]
    if unusual:
        yield "anomalies", ", ".join(unusual)
    if figures["published"] is not None:
        yield "published", f"{figures['published']} stereo pairs, for other processes"
    for duration in DURATIONS:
        p50, p99 = figures[duration.field]["p50"], figures[duration.field]["p99"]
        if p50 is not None:
            yield duration.label, f"{p50:.1f} ms, 99 of 100 within {p99:.1f} ms: {duration.meaning}"
    left, right = figures["fakes"]["cpu_percent"]
    yield "processor", f"daemon {figures['daemon_cpu_percent']:.0f} % of a core, fakes {left:.0f} % and {right:.0f} %"
    yield "this machine", f"{figures['reference_step_ms']:.1f} ms for a step of the published algorithm"


def _lost(figures: Mapping[str, Any]) -> str:
    """The losses, and how many of the missing frames the simulation failed to send in time."""
    lost = figures["lost"]
    frames = sum(lost.get(reason, 0) for reason in ("left_missing", "right_missing", "trigger_ignored"))
    frames += 2 * lost.get("both_missing", 0)
    late = min(figures["fakes"]["overruns"], frames)
    return lost_in_words(lost, f" ({late} of these frames because a fake camera was late)" if late else "")
