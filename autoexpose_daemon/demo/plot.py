"""The demo's picture: light, exposure and metric over time, with frames as the left camera saw them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autoexpose_daemon.demo.fakes import Pulse
from autoexpose_daemon.demo.record import Recorder

_PICTURES = 9


def draw(path: Path, pulses: Sequence[Pulse], recorder: Recorder, title: str) -> None:
    """Draw a run into a PNG file."""
    mpl.use("Agg")
    figure = Figure(figsize=(12, 9.5), layout="constrained")
    figure.suptitle(title)
    axes = figure.subplots(6, 1, sharex=True, height_ratios=[1.5, 1, 1.6, 1, 1, 1])
    start_ns = pulses[0].host_time_ns if pulses else 0
    end_s = (pulses[-1].host_time_ns - start_ns) * 1e-9 if pulses else 1.0
    steps = recorder.steps
    times_s = np.array([step.host_time_ns - start_ns for step in steps]) * 1e-9

    _strip(axes[0], recorder, start_ns, end_s)
    axes[1].semilogy([(p.host_time_ns - start_ns) * 1e-9 for p in pulses], [p.lux for p in pulses], color="goldenrod")
    _label(axes[1], "illumination\nlux")
    axes[2].plot(times_s, [step.decided_level for step in steps], "--", color="tab:orange", lw=1.2, label="decided")
    axes[2].plot(times_s, [step.applied.level for step in steps], color="tab:blue", lw=1.4, label="applied")
    axes[2].legend(loc="upper right", ncols=2, frameon=False)
    _label(axes[2], "exposure level E\nstops")
    axes[3].semilogy(times_s, [step.applied.exposure_time_us for step in steps], color="tab:green")
    _label(axes[3], "exposure time\nus")
    axes[4].plot(times_s, [step.applied.gain_db for step in steps], color="tab:red")
    _label(axes[4], "gain\ndB")
    axes[5].plot(times_s, [step.metric for step in steps], color="tab:purple")
    _label(axes[5], "metric")
    axes[5].set_xlabel("time, s")
    axes[5].set_xlim(0, end_s)
    figure.savefig(path, dpi=100)


def _label(axes: Axes, text: str) -> None:
    axes.set_ylabel(text)
    axes.grid(alpha=0.3)


def _strip(axes: Axes, recorder: Recorder, start_ns: int, end_s: float) -> None:
    """Frames side by side, each above the time it was taken at."""
    axes.set_ylabel("left camera")
    axes.set_yticks([])
    axes.set_ylim(0, 1)
    if not recorder.pictures:
        return
    times_s = np.array([time_ns - start_ns for time_ns, _ in recorder.pictures]) * 1e-9
    width_s = end_s / _PICTURES
    for slot in range(_PICTURES):
        nearest = int(np.argmin(abs(times_s - (slot + 0.5) * width_s)))
        extent = (slot * width_s, (slot + 0.97) * width_s, 0.0, 1.0)
        axes.imshow(recorder.pictures[nearest][1], cmap="gray", vmin=0, vmax=255, aspect="auto", extent=extent)
