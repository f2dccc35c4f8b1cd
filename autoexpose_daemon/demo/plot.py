"""The demo's picture: how the exposure followed the light, with frames of the left camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from autoexpose_daemon.demo.analysis import DemoRun, LightStep, StepLog, lost_pulses

_PICTURES = 8
_FEW_STEPS = 6  # up to this many, there is room for a sentence each
_MANY_STEPS = 40  # up to this many, for a number each
_DARK = "#e9e9f1"
_STYLE: dict[Any, Any] = {
    "font.size": 12,
    "axes.titlesize": 12,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
}


def draw(path: Path, run: DemoRun, steps: Sequence[LightStep]) -> None:
    """Draw a run into a PNG file."""
    mpl.use("Agg")
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(12, 12), layout="constrained")
        strip, *curves = figure.subplots(6, 1, sharex=True, height_ratios=[1.7, 1.2, 1, 1, 1, 1])
        about = f"policy {run.options.policy}, scene {run.options.scene}, {run.rate_hz:g} stereo pairs a second"
        figure.suptitle(f"{headline(steps)}\n{about}", fontsize=15)
        start_ns = run.pulses[0].host_time_ns if run.pulses else 0
        pulse_s = _seconds([pulse.host_time_ns for pulse in run.pulses], start_ns)
        lux = np.array([pulse.lux for pulse in run.pulses])
        end_s = float(pulse_s[-1]) if len(pulse_s) > 1 else 1.0
        _strip(strip, run.step_log, start_ns, end_s)
        _light(curves[0], pulse_s, lux, steps)
        _exposure(curves[1:], run.step_log, start_ns)
        lost_s = _seconds(lost_pulses(run.pulses, run.step_log.pairs_ns), start_ns)
        mark_losses(curves[-1], lost_s, sum(camera.overruns for camera in run.cameras))
        curves[-1].set_xlabel("seconds")
        curves[-1].set_xlim(0, end_s)
        for axes in curves:
            _shade_the_dark(axes, pulse_s, lux)
            for step in steps:
                axes.axvline(step.time_s, color="black", lw=0.8, ls=":")
        figure.savefig(path, format="png", dpi=100)  # whatever the name ends in


def headline(steps: Sequence[LightStep]) -> str:
    """How the exposure followed all steps of the light."""
    frames = sorted(step.frames_to_steady for step in steps if step.frames_to_steady is not None)
    if not frames:
        return "Exposure in the light of a room"
    often = f"{frames[0]} to {frames[-1]}" if frames[0] < frames[-1] else f"{frames[0]}"
    said = f"The light changes, and the exposure is good again after {often} {_noun(frames[-1])}"
    never = len(steps) - len(frames)
    return f"{said}, but not after {never} of {len(steps)} changes" if never else said


def _noun(frames: int) -> str:
    return "frame" if frames == 1 else "frames"


def _light(axes: Axes, pulse_s: NDArray[np.float64], lux: NDArray[np.float64], steps: Sequence[LightStep]) -> None:
    """The light, and at each of its steps how soon the exposure was good again, as room permits."""
    axes.set_title("Light in the room")
    axes.semilogy(pulse_s, lux, color="darkgoldenrod", lw=2)
    axes.margins(y=0.15)
    _label(axes, "lux")
    if len(steps) > _FEW_STEPS:
        axes.set_title("Light in the room, and after how many frames the exposure was good again")
    for step in steps if len(steps) <= _MANY_STEPS else []:
        frames = step.frames_to_steady
        text = "-" if frames is None else f"{frames}"
        if len(steps) <= _FEW_STEPS:
            soon = "not steady" if frames is None else f"good again after\n{frames} {_noun(frames)}"
            text = f"{step.from_lux:g} to {step.to_lux:g} lux:\n{soon}"
        axes.annotate(
            text,
            (step.time_s, 0.5),
            xycoords=axes.get_xaxis_transform(),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
        )


def _exposure(curves: Sequence[Axes], step_log: StepLog, start_ns: int) -> None:
    """Exposure time, gain, both together, and what is lost in the picture."""
    time, gain, level, lost = curves
    times_s = _seconds([step.host_time_ns for step in step_log.steps], start_ns)
    time.set_title("Exposure time: a longer one gathers more light, and blurs what moves")
    time.semilogy(times_s, [step.applied.exposure_time_us / 1e3 for step in step_log.steps], color="tab:green")
    _label(time, "ms")
    gain.set_title("Gain: amplifies the image, and its noise")
    gain.plot(times_s, [step.applied.gain_db for step in step_log.steps], color="tab:red")
    gain.set_ylabel("dB")
    level.set_title("Both together: one stop more, and the image is twice as bright")
    decided = [step.decided_level for step in step_log.steps]
    level.plot(times_s, decided, "--", color="tab:orange", label="decided")
    applied = [step.applied.level for step in step_log.steps]
    level.plot(times_s, applied, color="tab:blue", lw=1.8, label="what frames were taken with")
    level.set_ylabel("stops")
    level.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False, borderpad=0, borderaxespad=0.2)
    lost.set_title("What the image does not show: white or black pixels")
    lost.plot(times_s, [100 * step.saturated_share for step in step_log.steps], color="tab:red", label="white")
    lost.plot(times_s, [100 * step.black_share for step in step_log.steps], color="black", label="black")
    lost.set_ylabel("%")
    lost.legend(loc="best", frameon=False)


def _label(axes: Axes, unit: str) -> None:
    """A logarithmic axis in plain numbers; one of little more than a decade has them at 2 and 5, too."""
    axes.set_ylabel(unit)
    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 20 * low else (1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: "")


def _seconds(times_ns: Sequence[int], start_ns: int) -> NDArray[np.float64]:
    return np.asarray((np.array(times_ns, np.int64) - start_ns) * 1e-9, np.float64)


def _strip(axes: Axes, step_log: StepLog, start_ns: int, end_s: float) -> None:
    """Frames side by side, each above the time it was taken at."""
    axes.set_title("What the left camera saw")
    axes.set_yticks([])
    axes.set_ylim(0, 1)
    axes.spines[:].set_visible(False)
    axes.grid(visible=False)
    axes.tick_params(bottom=False)
    if not step_log.pictures:
        return
    times_s = _seconds([time_ns for time_ns, _ in step_log.pictures], start_ns)
    width_s = end_s / _PICTURES
    for slot in range(_PICTURES):
        nearest = int(np.argmin(abs(times_s - (slot + 0.5) * width_s)))
        extent = (slot * width_s, (slot + 0.98) * width_s, 0.0, 1.0)
        axes.imshow(step_log.pictures[nearest][1], cmap="gray", vmin=0, vmax=255, aspect="auto", extent=extent)


def _shade_the_dark(axes: Axes, pulse_s: NDArray[np.float64], lux: NDArray[np.float64]) -> None:
    """Grey while the light is less than half the brightest, if it ever is."""
    if len(lux) and lux.min() < lux.max() / 2:
        axes.fill_between(
            pulse_s, 0, 1, where=list(lux < lux.max() / 2), transform=axes.get_xaxis_transform(), color=_DARK, zorder=0
        )


def mark_losses(axes: Axes, lost_s: NDArray[np.float64], late_frames: int) -> None:
    """A tick at the foot for each stereo pair that was lost."""
    if len(lost_s):
        axes.plot(lost_s, np.zeros(len(lost_s)), "|", color="red", ms=12, mew=1.5)
        late_frames = min(late_frames, 2 * len(lost_s))  # others were late before the first pair, or after the last
        whose = f" ({late_frames} frames by late fake cameras)" if late_frames else ""
        axes.set_title(f"| {len(lost_s)} stereo pairs lost{whose}", loc="right", color="red")
