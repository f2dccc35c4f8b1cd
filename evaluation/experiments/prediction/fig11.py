"""B&H Fig. 11: the exposure that gamma curves consider best, and the true best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.drawing import COLOURS, panels, save
from evaluation.experiments.experiment import Claim, Experiment, Figure, ReportSection, Results, Table, Verdict
from evaluation.experiments.prediction.still_life import LAWS, camera_of, measure_rest, summary
from evaluation.intervals import Interval, mean_interval
from evaluation.jobs.job import Job
from evaluation.prose import text_beside
from evaluation.stage.camera import CameraResponse

LUX = 50.0
# The paper's camera, taken to be linear, and the two that the paper derived from it by gamma transformations.
THE_PAPERS = (CameraResponse("linear"), CameraResponse("linear", 0.6), CameraResponse("linear", 0.3))
# The paper's, and the fake camera's other responses.
CAMERAS = (*THE_PAPERS, CameraResponse("gamma"), CameraResponse("s_shaped"))
# A best level that moves by less from camera to camera varies slightly: gamma curves err by 1 to 3 stops.
SLIGHT_STOPS = 1.0
_LAW_NAMES = {"begin2022": "by the response", "shim2018": "by gamma, shim2018", "mehta2020": "by gamma, mehta2020"}


def jobs(quick: bool) -> list[Job]:
    """One for each camera and scene."""
    rooms = [("room", seed) for seed in range(2 if quick else 16)]
    stills = [(scene, seed) for scene in ("leaves", "street", "hall") for seed in range(8)]
    chosen = [*rooms, ("leaves", 0), ("hall", 0)] if quick else [*rooms, *stills]
    levels = np.arange(7.5, 17.8, 0.5 if quick else 0.125).tolist()
    return [
        Job(
            measure_rest,
            {"scene": scene, "seed": seed, "lux": LUX, "camera": [camera.curve, camera.gamma], "levels": levels},
            0.2 if quick else 0.5,
        )
        for scene, seed in chosen
        for camera in CAMERAS
    ]


# For each camera, what `predicted_optimum.summary` returns for each scene, with scenes in the same order.
Summaries = Mapping[CameraResponse, Sequence[Mapping[str, Mapping[str, float]]]]


def section(results: Results, folder: Path) -> ReportSection:
    """Judge the three claims of section 3.2."""
    found: dict[CameraResponse, list[Mapping[str, Mapping[str, float]]]] = {}
    for arguments, measured in results:
        found.setdefault(camera_of(arguments), []).append(summary(measured))
    scenes = [str(arguments["scene"]) for arguments, _ in results if camera_of(arguments) == CAMERAS[0]]
    shown = results[0][0]
    _draw(
        {camera_of(a): m for a, m in results if (a["scene"], a["seed"]) == (shown["scene"], shown["seed"])},
        f"{shown['scene']}, seed {shown['seed']}, {LUX:g} lux",
        folder / "fig11.png",
    )
    return ReportSection(
        text_beside(__file__),
        [_underestimates(found), _steady_optimum(found, scenes), _closer(found)],
        [
            Figure(
                "fig11.png",
                "Above, M_g against exposure level for each response; dashed lines mark the best levels. Below, how "
                "far Shim's law (gamma curves, solid lines) and `begin2022` (dotted) want to go; solid vertical lines "
                "mark where Shim's law comes to rest.",
            ),
            _table(found, scenes),
        ],
    )


def _bias(found: Summaries, camera: CameraResponse, law: str) -> Interval:
    """Mean over the scenes in which the law comes to rest."""
    return mean_interval([b for scene in found[camera] if np.isfinite(b := scene[law]["bias"])])


def _linear_bias(found: Summaries, scenes: Sequence[str], *, rooms: bool) -> str:
    biases = [
        scene["shim2018"]["bias"]
        for name, scene in zip(scenes, found[CAMERAS[0]], strict=True)
        if (name == "room") == rooms
    ]
    return mean_interval([bias for bias in biases if np.isfinite(bias)]).text("+.1f")


def _ruled(holding: Sequence[object], claimed: Sequence[object], where: str) -> tuple[Verdict, str]:
    """Reproduced when a claim holds for everything it was made for, under conditions when it holds for some."""
    if set(claimed) <= set(holding):
        return Verdict.REPRODUCED, ""
    if holding:
        return Verdict.CONDITIONALLY, f"{where} {', '.join(map(str, holding))}"
    return Verdict.NOT_REPRODUCED, ""


def _underestimates(found: Summaries) -> Claim:
    biases = {camera: _bias(found, camera, "shim2018") for camera in CAMERAS}
    low = [camera for camera in CAMERAS if biases[camera].high < 0]
    verdict, condition = _ruled(low, THE_PAPERS, "for")
    return Claim(
        "B&H 3.2, Fig. 11",
        "Gamma curves systematically underestimate the best exposure level",
        "bias in stops: " + ", ".join(f"{camera} {biases[camera].text('+.1f')}" for camera in CAMERAS),
        verdict,
        condition,
    )


def _steady_optimum(found: Summaries, scenes: Sequence[str]) -> Claim:
    """Judged for each kind of scene separately: kinds differ more than scenes of a kind."""
    kinds = list(dict.fromkeys(scenes))
    true = dict(zip(kinds, (_range(found, scenes, kind, "true") for kind in kinds), strict=True))
    gamma = {kind: _range(found, scenes, kind, "shim2018") for kind in kinds}
    steady = [kind for kind in kinds if true[kind].high < SLIGHT_STOPS and true[kind].high < gamma[kind].low]
    verdict, condition = _ruled(steady, kinds, "before")
    return Claim(
        "B&H 3.2, Fig. 11",
        "The true best level varies only slightly from response to response",
        "over the paper's three, in stops: "
        + ", ".join(f"{kind} {true[kind].text('.1f')} (by gamma curves {gamma[kind].text('.1f')})" for kind in kinds),
        verdict,
        condition,
    )


def _range(found: Summaries, scenes: Sequence[str], kind: str, law: str) -> Interval:
    """The range of a law's levels over the paper's cameras (stops), mean over scenes of a kind."""
    spreads = [
        np.ptp(np.array([by_law[law]["level"] for by_law in scene]))
        for name, *scene in zip(scenes, *(found[camera] for camera in THE_PAPERS), strict=True)
        if name == kind
    ]
    return mean_interval([spread for spread in spreads if np.isfinite(spread)])


def _closer(found: Summaries) -> Claim:
    """Judged by the difference of the two absolute biases, paired by scene."""
    closer = {}
    for camera in CAMERAS:
        pairs = [(abs(scene["shim2018"]["bias"]), abs(scene["begin2022"]["bias"])) for scene in found[camera]]
        closer[camera] = mean_interval([gamma - prf for gamma, prf in pairs if np.isfinite(gamma - prf)])
    better = [camera for camera in CAMERAS if closer[camera].low > 0]
    verdict, condition = _ruled(better, THE_PAPERS, "for")
    biases = ", ".join(f"{camera} {_bias(found, camera, 'begin2022').text('+.1f')}" for camera in CAMERAS)
    return Claim(
        "B&H 3.2",
        "Prediction by the response avoids that bias and ends closer to the true best level",
        "nearer by, in stops: "
        + ", ".join(f"{camera} {closer[camera].text('.1f')}" for camera in CAMERAS)
        + f"; its own bias: {biases}",
        verdict,
        condition,
    )


def _table(found: Summaries, scenes: Sequence[str]) -> Table:
    rows = []
    for camera in CAMERAS:
        for law in LAWS:
            at_rest = [scene[law] for scene in found[camera] if np.isfinite(scene[law]["bias"])]
            rows.append([
                f"{camera}, {_LAW_NAMES[law]}",
                _bias(found, camera, law).text("+.2f"),
                mean_interval([scene["share"] for scene in at_rest]).text(),
                f"{len(at_rest)} of {len(found[camera])}",
            ])  # fmt: skip
    caption = (
        "Where laws come to rest, mean over scenes: bias, and the metric there as a share of the largest. With a "
        f"linear response the bias of gamma curves (`shim2018`) is {_linear_bias(found, scenes, rooms=True)} stops in "
        f"rooms and {_linear_bias(found, scenes, rooms=False)} in painted stills."
    )
    return Table(caption, ["response, prediction", "bias (stops)", "share of the best M_g", "scenes with rest"], rows)


def _draw(measured: Mapping[CameraResponse, Mapping[str, Any]], title: str, file: Path) -> None:
    figure, (upper, lower) = panels(2, 1, 6.4, sharex=True)
    for colour, (camera, each) in zip(COLOURS, measured.items(), strict=False):
        levels, found = each["levels"], summary(each)
        upper.plot(levels, each["metrics"], color=colour, label=str(camera))
        upper.axvline(found["true"]["level"], color=colour, linestyle="--", linewidth=1.0)
        lower.plot(levels, each["shim2018"], color=colour)
        lower.plot(levels, each["begin2022"], color=colour, linestyle=":")
        lower.axvline(found["shim2018"]["level"], color=colour, linewidth=1.0)
    upper.set_ylabel("M_g per pixel")
    upper.legend(fontsize=8)
    upper.set_title(title, fontsize=10)
    lower.axhline(0.0, color="black", linewidth=0.8)
    lower.set(ylim=(-4.0, 4.0), ylabel="step wanted (stops)", xlabel="exposure level E (stops)")
    save(figure, file)


EXPERIMENT = Experiment("fig11", "The best exposure as gamma curves see it, and the true one", jobs, section)
