"""From looks at many gains to the scale of the gain, and whether to believe it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.findings import Finding
from calibration.gain.capture import GainLooks

Array = NDArray[np.float64]

NO_EFFECT_DB = 0.5
CHANGED_DB, DOUBTED_DB = 0.5, 0.1
"""Difference between the two looks at one gain from which the light counts as changed: refused, warned of."""
UNEVEN = 0.1
"""If the patches of a scene disagree by more about one gain, the scene moved."""
FALL_DB = 0.1
SIGMAS = 2.0
LEAST_ERROR_DB = 0.02
"""Cameras round exposure times without saying so."""


@dataclass(frozen=True, slots=True, eq=False)
class GainCurve:
    """Gains in dB above the lowest.

    Attributes
    ----------
    settings
        The gains in the camera's own numbers, rising, shape (n,).
    gains_db
        Their values in dB, not falling, the first 0; empty if the looks give none.
    error_db
        How far any gain within the range may be from the truth: 0.02 dB, the spread of the two passes (two standard
        errors), and what straight lines between the settings miss.
    findings
        Reasons not to believe it.
    """

    settings: Array
    gains_db: Array
    error_db: float
    findings: tuple[Finding, ...]


def solve_gain(looks: GainLooks) -> GainCurve:
    """The gain in dB of each setting that was looked at, and the reasons against believing it."""
    settings = np.array([seen.number for seen in looks.there])
    reference = looks.there[0]
    there, back = (np.array([seen.gain_db(reference) for seen in way]) for way in (looks.there, looks.back))
    unseen = ~np.isfinite(there + back)
    if unseen.any():
        return _refused(settings, "clipped", _unseen(settings[unseen], len(settings)))
    apart_db = np.abs(back - there)
    unevenness = max(seen.unevenness(reference) for way in (looks.there, looks.back) for seen in way)
    raw_db = (there + back) / 2.0
    raw_db -= raw_db[0]
    findings = tuple(_judge(settings, raw_db, float(apart_db.max()), unevenness))
    gains_db = np.maximum.accumulate(raw_db)
    spread_db = SIGMAS * float(np.sqrt(np.mean(apart_db**2))) / 2.0
    levelled_db = float((gains_db - raw_db).max())
    missed_db = _missed_db(settings, gains_db, looks.step)
    return GainCurve(settings, gains_db, LEAST_ERROR_DB + spread_db + levelled_db + missed_db, findings)


def _missed_db(settings: Array, gains_db: Array, step: float) -> float:
    """What straight lines may miss between settings that are more than a step apart.

    A line misses no more than longer ones, without the setting at either of its ends, miss there.
    """
    if len(settings) < 3:
        return 0.0
    part = (settings[1:-1] - settings[:-2]) / (settings[2:] - settings[:-2])
    bend_db = np.abs(gains_db[1:-1] - gains_db[:-2] - part * (gains_db[2:] - gains_db[:-2]))
    at_ends = np.concatenate([bend_db[:1], bend_db, bend_db[-1:]])
    missed_db = np.minimum(at_ends[:-1], at_ends[1:])
    return float(missed_db[np.diff(settings) > 1.5 * step].max(initial=0.0))


def _judge(settings: Array, raw_db: Array, apart_db: float, unevenness: float) -> Iterator[Finding]:
    if unevenness > UNEVEN:
        yield Finding(
            "refused", "moving_scene",
            f"parts of the picture disagree by {unevenness:.0%} about one gain: put the camera on a tripod and keep "
            "out of the picture",
        )  # fmt: skip
    elif apart_db > DOUBTED_DB:
        yield Finding(
            "refused" if apart_db > CHANGED_DB else "warned", "light_changed",
            f"one gain measured twice differs by {apart_db:.2f} dB: use light that neither changes nor flickers, and "
            "let lamps warm up",
        )  # fmt: skip
    if np.abs(raw_db).max() < NO_EFFECT_DB:
        yield Finding(
            "refused", "no_effect",
            f"the gain has no effect: {np.abs(raw_db).max():.2f} dB from {settings[0]:g} to {settings[-1]:g}; see "
            "whether another feature disables it",
        )  # fmt: skip
        return
    falls_db = np.maximum.accumulate(raw_db) - raw_db
    worst = int(falls_db.argmax())
    if falls_db[worst] > FALL_DB + apart_db:
        yield Finding(
            "refused", "not_rising",
            f"the image gets darker by {falls_db[worst]:.1f} dB as the gain rises to {settings[worst]:g}: such a gain "
            "cannot be driven",
        )  # fmt: skip


def _unseen(settings: Array, count: int) -> str:
    return (
        f"at {len(settings)} of {count} gains, such as {settings[0]:g}, nearly all of the picture is black or "
        "saturated at any exposure time that the camera takes: choose a scene of middle grey, and "
        "brighter or dimmer light"
    )


def _refused(settings: Array, reason: str, text: str) -> GainCurve:
    return GainCurve(settings, np.empty(0), float("nan"), (Finding("refused", reason, text),))
