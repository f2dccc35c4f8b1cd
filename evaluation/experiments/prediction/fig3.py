"""B&H Fig. 3: response functions, the prediction curves they imply, and gamma curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.drawing import COLOURS, panels, save
from evaluation.experiments.experiment import Claim, Experiment, Figure, ReportSection, Results, Table, Verdict
from evaluation.experiments.prediction.still_life import camera_of, gamma_curve, measure_changes
from evaluation.intervals import Interval, mean_interval
from evaluation.jobs.job import Job
from evaluation.prose import text_beside
from evaluation.stage.camera import FAKE_CAMERAS, CameraResponse
from imaging.response import prediction_table

LUX = 50.0
CHANGES = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)  # In stops: the changes that the paper's algorithm predicts
# Levels of well-exposed frames to start from: most pixels are neither black nor white.
LEVELS = {"room": 11.5, "leaves": 13.5, "street": 13.0, "hall": 13.5}
EXACT_GREY = 1.0  # A prediction with a smaller error (rms, grey levels) is as good as 8 bits allow
FAR_GREY = 4.0  # A prediction with a larger error is off by more than the noise of most frames
_SHOWN = (-2.0, -1.0, 1.0, 2.0)
_SHOTS = 16


def jobs(quick: bool) -> list[Job]:
    """One for each camera and scene."""
    rooms = [("room", seed) for seed in range(1 if quick else 8)]
    stills = [(scene, seed) for scene in ("leaves", "street", "hall") for seed in range(4)]
    return [
        Job(
            measure_changes,
            {
                "scene": scene, "seed": seed, "lux": LUX, "camera": [camera.curve, camera.gamma],
                "level": LEVELS[scene], "changes": list(CHANGES), "shots": 8 if quick else _SHOTS,
            },
            0.5,
        )
        for scene, seed in [*rooms, *stills[: 1 if quick else None]]
        for camera in FAKE_CAMERAS
    ]  # fmt: skip


def section(results: Results, folder: Path) -> ReportSection:
    """Judge prediction by the response and by gamma curves."""
    by_camera: dict[CameraResponse, list[Sequence[Mapping[str, Any]]]] = {}
    for arguments, found in results:
        by_camera.setdefault(camera_of(arguments), []).append(found)
    _draw(by_camera, folder / "fig3.png")
    exact = {camera: _over_all(found, "response_rms") for camera, found in by_camera.items()}
    gamma = {camera: _over_all(found, "gamma_rms") for camera, found in by_camera.items()}
    brighter = {camera: _at(found, 1.0, "gamma").value for camera, found in by_camera.items()}
    return ReportSection(
        text_beside(__file__),
        [
            Claim(
                "B&H 2.1, Fig. 3",
                "With the response known, every grey level has its counterpart under any change of exposure",
                f"rms error, grey levels: {_by_camera(exact)}",
                Verdict.of(all(e.high < EXACT_GREY for e in exact.values())),
                "for pixels that are not clipped",
            ),
            Claim(
                "B&H 1.2, 1.4, Fig. 3",
                "Gamma curves have no direct link to changes of exposure, and another shape",
                f"the best of them err by, rms grey levels: {_by_camera(gamma)}; one stop more is best met by gamma "
                + ", ".join(f"{value:.2f} ({camera})" for camera, value in brighter.items()),
                Verdict.of(all(e.low > FAR_GREY for e in gamma.values())),
            ),
        ],
        [
            Figure(
                "fig3.png",
                "Above, the responses. Below, what grey levels become: lines as predicted from the response, dots as "
                "seen, dashes the best gamma curve of the same scene.",
            ),
            _table(by_camera),
        ],
    )


def _over_all(found: Sequence[Sequence[Mapping[str, Any]]], figure: str) -> Interval:
    """Mean over scenes of the mean over changes."""
    return mean_interval([np.mean([change[figure] for change in scene]) for scene in found])


def _at(found: Sequence[Sequence[Mapping[str, Any]]], change: float, figure: str) -> Interval:
    return mean_interval([row[figure] for scene in found for row in scene if row["change"] == change])


def _by_camera(intervals: Mapping[CameraResponse, Interval]) -> str:
    return ", ".join(f"{camera} {interval.text('.1f')}" for camera, interval in intervals.items())


def _table(by_camera: Mapping[CameraResponse, Sequence[Sequence[Mapping[str, Any]]]]) -> Table:
    rows = []
    for camera, found in by_camera.items():
        rows.append([f"{camera}: by the response", *(_at(found, c, "response_rms").text(".1f") for c in CHANGES)])
        rows.append([f"{camera}: by the best gamma", *(_at(found, c, "gamma_rms").text(".1f") for c in CHANGES)])
        rows.append([f"{camera}: that gamma", *(_at(found, c, "gamma").text(".2f") for c in CHANGES)])
    heads = ["rms error, grey levels", *(f"{change:+g} stops" for change in CHANGES)]
    return Table(
        "Errors over pixels that are neither black nor white before the change; mean over scenes.", heads, rows
    )


def _draw(by_camera: Mapping[CameraResponse, Sequence[Sequence[Mapping[str, Any]]]], file: Path) -> None:
    figure, axes = panels(2, len(by_camera), 6.2, sharey=True)
    for (upper, lower), (camera, found) in zip(axes.T, by_camera.items(), strict=True):
        response = camera.function
        stops = np.linspace(-10.0, 1.0, 400)
        upper.plot(stops, response.intensity(stops), color=COLOURS[0])
        upper.set_title(str(camera), fontsize=10)
        upper.set_xlabel("exposure (stops from saturation)")
        for colour, change in zip(COLOURS, _SHOWN, strict=False):
            row = next(row for row in found[0] if row["change"] == change)
            lower.plot(prediction_table(response, change), color=colour, linewidth=1.4, label=f"{change:+g} stops")
            lower.plot(gamma_curve(row["gamma"]), color=colour, linewidth=1.0, linestyle="--")
            seen = [(grey, value) for grey, value in enumerate(row["seen"]) if value is not None and grey % 8 == 0]
            lower.scatter(*zip(*seen, strict=True), color=colour, s=9)
        lower.set_xlabel("grey level before")
    axes[0, 0].set_ylabel("grey level")
    axes[1, 0].set_ylabel("grey level after")
    figure.legend(*axes[1, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(_SHOWN), fontsize=9)
    save(figure, file)


EXPERIMENT = Experiment("fig3", "Prediction curves from the response, and gamma curves", jobs, section)
