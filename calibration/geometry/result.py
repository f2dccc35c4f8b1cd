"""From views of a board to judged calibration files of both cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2

from calibration.findings import Finding
from calibration.geometry.board import Board
from calibration.geometry.fit import Fit, fit_pair
from calibration.geometry.judge import judge_fit, judge_scores, judge_views
from calibration.geometry.plausible import check_plausible
from calibration.geometry.rectify import rectified
from calibration.geometry.score import Score, score
from calibration.geometry.views import View
from calibration.result import Verdict, verdict
from imaging.errors import ConfigurationError
from imaging.frames import SIDES, Side
from imaging.geometry import CameraGeometry

HELD_OUT = 5
"""One view in this many is kept out of the fit, and shows whether it holds."""


@dataclass(frozen=True, slots=True, eq=False)
class GeometryResult:
    """Views of a board, what they say, and whether to believe it.

    Attributes
    ----------
    board, views, size
        What was shown, what was seen of it, and the width and height of the pictures.
    findings
        Reasons not to believe it.
    fit, geometries
        Both cameras, and their geometry as the files have it; None if the views give none.
    used, held_out
        How well single views agree: those of the fit, and the others.
    """

    board: Board
    views: Sequence[View]
    size: tuple[int, int]
    findings: tuple[Finding, ...]
    fit: Fit | None = None
    geometries: Mapping[Side, CameraGeometry] | None = None
    used: Sequence[Score] = ()
    held_out: Sequence[Score] = ()

    @property
    def verdict(self) -> Verdict:
        """Whether to believe it."""
        return verdict(self.findings)


def calibrate_geometry(
    board: Board,
    views: Sequence[View],
    size: tuple[int, int],
    serials: Mapping[Side, str] | None = None,
    instead: Mapping[Side, str] | None = None,
) -> GeometryResult:
    """Judge the views, fit four fifths of them unless they are refused, and judge the fit by the others, too.

    `instead` says what a camera saw if it saw no board.
    """
    views = [view for view in views if view.corners]
    result = GeometryResult(board, views, size, tuple(judge_views(views, size, instead or {})))
    if result.verdict == "refused":
        return result
    shared = [view for view in views if view.by_both]
    held_out = shared[HELD_OUT - 1 :: HELD_OUT]
    used = [view for view in views if view not in held_out]
    try:
        fit = fit_pair(board, used, size, serials or {})
        left, right = (fit.lenses[side].geometry for side in SIDES)
        pair = rectified(left, right, fit.rotation, fit.translation_m)
        for geometry in pair:
            check_plausible(geometry)
    except (ConfigurationError, cv2.error) as error:
        return _refused(result, error)
    geometries = dict(zip(SIDES, pair, strict=True))
    result = replace(
        result,
        fit=fit,
        geometries=geometries,
        used=score(board, geometries, used),
        held_out=score(board, geometries, held_out),
    )
    found = (*result.findings, *judge_fit(fit), *judge_scores(result.used, result.held_out))
    return replace(result, findings=found)


def _refused(result: GeometryResult, error: Exception) -> GeometryResult:
    text = str(error) if isinstance(error, ConfigurationError) else "no lens fits these views: take others"
    return replace(result, findings=(*result.findings, Finding("refused", "no_geometry", text)))
