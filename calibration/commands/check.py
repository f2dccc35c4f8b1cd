"""Whether a response file still predicts what its camera does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from calibration.commands.rig import CameraMode, check_gain, take
from calibration.document import Finding
from calibration.judges.sweep import judge_sweep
from calibration.response.file import ResponseFile
from calibration.solver.tones import Agreement, agreement, grey8, tones_by_exposure
from calibration.sources.session import Session
from calibration.sources.sweep import FIRST_TIME_US, StaticCamera, Sweep, SweepPlan, time_bounds_us
from drivers.aravis import open_camera
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction

GOOD_GREY = 1.5
"""Residual up to which a file is believed: one grey level of the curve, and what noise adds."""
USABLE_GREY = 3.0
REACH_STOPS = 2.0
STEPS = 9
FRAMES = 4
HEADROOM_STOPS = 2.0
"""How far below saturation the median of the scene is put: the brightest exposure then just reaches it."""
NEAR_STOPS = 0.5
MOST_STOPS = 20.0
"""Largest change of exposure time in a search step, even if a foreign file implies more than any camera has."""
_TRIES = 6  # a scene all black or all white gives only a direction


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """What a file predicts, compared with what the camera shows.

    Attributes
    ----------
    agreement
        Grey levels predicted and seen.
    findings
        What is wrong with the images, and with the file.
    """

    agreement: Agreement
    findings: tuple[Finding, ...]


def check_camera(path: Path, serial: str, console: Console) -> Check:
    """Take a static scene at exposures over two stops up and down, and predict each from the others.

    Raises
    ------
    ConfigurationError
        When the file cannot be read, or belongs to another camera or mode.
    CameraError
        When the camera fails.
    """
    file = ResponseFile.load(path)
    origin = file.origin
    file.check_belongs(serial)
    mode = CameraMode(serial, origin.pixel_format, origin.binning)
    gain_db = origin.gain_db or 0.0
    with Session(open_camera(serial, mode.setup())) as session:
        file.check_belongs(serial, session.description.pixel_format)
        check_gain(session, gain_db)
        plan = plan_check(session, file.response, gain_db)
        sweep = Sweep(take(session, plan, serial, console))
    match = agreement(file.response, tones_by_exposure(sweep))
    # Four stops need not cover many grey levels, but they must show that light and scene stood still.
    unsteady = [finding for finding in judge_sweep(sweep) if finding.reason != "few_levels"]
    return Check(match, (*unsteady, *judge_agreement(match, serial)))


def plan_check(camera: StaticCamera, response: ResponseFunction, gain_db: float) -> SweepPlan:
    """Exposures over two stops up and down from where the median of this scene is well exposed, up and down again."""
    shortest_us, longest_us = time_bounds_us(camera.limits)
    time_us = min(max(FIRST_TIME_US, shortest_us), longest_us)
    target = float(response.log2_exposure[response.saturation]) - HEADROOM_STOPS
    for _ in range(_TRIES):
        (shot,) = camera.take(ExposureSetting(time_us, gain_db), 1)
        missing = target - float(response.inverse(np.array([int(np.median(grey8(shot)))]))[0])
        time_us = min(max(time_us * 2.0 ** min(max(missing, -MOST_STOPS), MOST_STOPS), shortest_us), longest_us)
        if abs(missing) < NEAR_STOPS:
            break
    stops = np.linspace(-REACH_STOPS, REACH_STOPS, STEPS)
    times_us = np.unique(np.clip(time_us * 2.0**stops, shortest_us, longest_us))
    up = [ExposureSetting(float(each_us), gain_db) for each_us in times_us]
    return SweepPlan((*up, *reversed(up)), FRAMES)


def judge_agreement(match: Agreement, serial: str) -> list[Finding]:
    """Whether what was seen is what the file predicts."""
    if not match.enough:
        text = "no part of the scene is between black and saturation in two exposures: show it another scene"
        return [Finding("refused", "nothing_to_compare", text)]
    if match.residual_grey <= GOOD_GREY:
        return []
    text = (
        f"predictions are off by {match.residual_grey:.1f} grey levels rms, where {GOOD_GREY:g} are expected: "
        f"calibrate again with autoexpose calibrate response --camera {serial}"
    )
    return [Finding("warned" if match.residual_grey <= USABLE_GREY else "refused", "disagreement", text)]
