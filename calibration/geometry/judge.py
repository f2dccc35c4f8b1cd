"""Reasons not to believe views of a board, or what follows from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from calibration.findings import Finding
from calibration.geometry.fit import Fit
from calibration.geometry.score import Score, overall
from calibration.geometry.views import TILTED_DEG, TILTS, View, covered, tilts
from imaging.frames import SIDES, Side

LEAST_VIEWS = 15
LEAST_COVERED = 0.5
GOOD_COVERED = 0.75
LEAST_TILTED = 2
"""Views turned in each direction; two, since one may be a mistake."""
GOOD_ERROR_PX, USABLE_ERROR_PX = 0.5, 1.0
GOOD_FOCAL_ERROR, USABLE_FOCAL_ERROR = 0.002, 0.01
OUTLIER = 3.0
"""A view stands out if its error is this many times the median."""


def judge_views(views: Sequence[View], size: tuple[int, int], instead: Mapping[Side, str]) -> Iterator[Finding]:
    """What is wrong with the views themselves: the board hardly seen, or only in a part of the picture.

    `instead` says what else a camera saw.
    """
    for side in SIDES:
        if not any(side in view.corners for view in views):
            advice = (
                f"{instead[side]}: give the squares and the dictionary of this board"
                if instead.get(side)
                else "it must be in the picture, sharp and neither dark nor white"
            )
            text = f"the {side} camera never saw the board: {advice}"
            yield Finding("refused", "never_seen", text)
            return
    both = sum(view.by_both for view in views)
    if both < LEAST_VIEWS:
        text = f"both cameras see the board in {both} views: show it in at least {LEAST_VIEWS}, better 40"
        yield Finding("refused", "few_views", text)
        return
    for side in SIDES:
        share = float(covered((view.corners[side] for view in views if side in view.corners), size).mean())
        if share < GOOD_COVERED:
            text = (
                f"corners were seen in {share:.0%} of the {side} picture: show the board in all of its parts, also "
                "near its edges, where lenses distort most"
            )
            yield Finding("refused" if share < LEAST_COVERED else "warned", "poor_coverage", text)


def judge_fit(fit: Fit) -> Iterator[Finding]:
    """What is wrong with the fit: it does not explain the pictures, or does not follow from them."""
    alone_px = max(lens.error_px for lens in fit.lenses.values())
    for side, lens in fit.lenses.items():
        directions = [name for normal in lens.normals for name in tilts(normal)]
        missing = [name for name in TILTS if directions.count(name) < LEAST_TILTED]
        if missing:
            text = (
                f"the {side} camera hardly saw the board turned by {TILTED_DEG:g} degrees to the "
                f"{', '.join(missing)}: turn it in all four directions, or the focal length stays unknown"
            )
            yield Finding("refused", "no_tilt", text)
        elif lens.focal_error > GOOD_FOCAL_ERROR:
            text = (
                f"the focal length of the {side} camera is known to {lens.focal_error:.1%} only: take more views, with "
                "the board turned more and nearer"
            )
            yield Finding("refused" if lens.focal_error > USABLE_FOCAL_ERROR else "warned", "focal_length", text)
        if lens.error_px > GOOD_ERROR_PX:
            text = (
                f"the {side} camera's corners are off by {lens.error_px:.2f} pixels rms: check the board's squares and "
                "that it is flat; a very wide lens needs the equidistant model, which Kalibr fits"
            )
            yield Finding("refused" if lens.error_px > USABLE_ERROR_PX else "warned", "reprojection", text)
    if fit.error_px > max(GOOD_ERROR_PX, 2.0 * alone_px):
        text = (
            f"the cameras fit alone (off by {alone_px:.2f} pixels rms), but not together ({fit.error_px:.2f}): check "
            "that the pictures of a pair show the same moment, and hold the board still"
        )
        yield Finding("refused" if fit.error_px > USABLE_ERROR_PX else "warned", "not_together", text)


def judge_scores(used: Sequence[Score], held_out: Sequence[Score]) -> Iterator[Finding]:
    """Whether single views stand out, and whether views that the fit has not used agree with it."""
    of_used, *_ = overall(used)
    of_held_out, rows_px, _ = overall(held_out)
    outliers = [each.name for each in used if max(each.error_px.values()) > max(OUTLIER * of_used, GOOD_ERROR_PX)]
    if outliers:
        text = f"views stand out: {', '.join(outliers)}: leave them out if they are blurred or the board was bent"
        yield Finding("warned", "outliers", text)
    worst_px = max(of_held_out, rows_px)
    if worst_px > max(GOOD_ERROR_PX, 2.0 * of_used):
        text = (
            f"views that were held out are off by {of_held_out:.2f} pixels, and by {rows_px:.2f} from the common row, "
            f"where those of the fit are off by {of_used:.2f}: take more views"
        )
        yield Finding("refused" if worst_px > USABLE_ERROR_PX else "warned", "held_out", text)
