"""Photon transfer after EMVA 1288: system gain, read noise, black level and full well, from pairs of images."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.document import Finding
from calibration.noise.light_lines import (
    BRIGHT,
    Estimate,
    LightLines,
    NoiseModel,
    Steadiness,
    fit_light_lines,
    judge_steadiness,
)
from calibration.sweep import FIRST_TIME_US, Shot, StaticCamera, Sweep, SweepPlan, exposure_us_for, time_bounds_us
from imaging.exposure import ExposureLimits, ExposureSetting

MOST_BINS = 1024
"""Bins of mean grey over the range of the format: one for each grey level of 8 bits, one for four of 12 bits."""
GROUPS = 512
"""Groups of pixels alike in brightness: finer than the bins, so that clipped pixels do not hide among others."""
MIN_DEGREES = 50
"""With fewer pixels, the variance of a bin is known to no better than 20 %."""

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class VarianceCurve:
    """Temporal variance over mean grey (DN), one entry for each bin of mean grey that holds enough pixels."""

    mean: Array  # mean grey of the bin's pixels, increasing
    variance: Array  # variance of one grey level from image to image (DN squared), quantisation taken out
    degrees: Array  # degrees of freedom of that variance: its relative standard error is sqrt(2 / degrees)
    bin_width: float  # width of the bins (DN); the first begins at 0
    step: int  # difference between neighbouring grey levels: 16 if 12 bits are sent as 16

    def variance_at(self, mean: Array) -> Array:
        """The variance at any grey level, between those of the bins."""
        return np.asarray(np.interp(mean, self.mean, self.variance))


def pairs_of(shots: Sequence[Shot]) -> list[tuple[int, int]]:
    """Indices of neighbouring shots of equal setting, each shot in one pair at most."""
    pairs: list[tuple[int, int]] = []
    for _, run in itertools.groupby(range(len(shots)), key=lambda index: shots[index].setting):
        alike = list(run)
        pairs += zip(alike[::2], alike[1::2], strict=False)
    return pairs


def grey_step(shots: Sequence[Shot]) -> int:
    """The greatest common divisor of all differences between grey levels."""
    seen = np.zeros(1 << 16, bool)
    for shot in shots:
        seen[shot.pixels] = True
    greys = np.flatnonzero(seen)
    return int(np.gcd.reduce(np.diff(greys))) if len(greys) > 1 else 1


def variance_curve(shots: Sequence[Shot], pairs: Sequence[tuple[int, int]]) -> VarianceCurve:
    """Half the variance of the difference of two images, by their mean: what stands still in the scene drops out.

    Pixels are grouped by how bright they are in the other pairs. Grouped by their own grey level, they would be
    sorted by their noise, too, and the darkest would be brighter pixels that their noise made dark. As variance is
    linear in the mean, it does not matter how alike the pixels of a group are. The mean difference is taken out group
    by group, and with it a change of the light between the two images.
    """
    means = [(shots[one].pixels.astype(np.float32) + shots[other].pixels).ravel() / 2.0 for one, other in pairs]
    total = np.sum(means, axis=0)
    count, mean, square = np.concatenate(
        [
            _groups(
                total - pair_mean, pair_mean, np.subtract(*(shots[index].pixels.astype(np.float32) for index in pair))
            )
            for pair, pair_mean in zip(pairs, means, strict=True)
        ],
        axis=1,
    )
    bins = min(2 ** shots[0].bit_depth, MOST_BINS)
    bin_width = 2 ** shots[0].bit_depth / bins
    index = (mean / bin_width).astype(np.intp)
    counts = np.bincount(index, count, bins)
    degrees = np.bincount(index, count - 1.0, bins)
    full = degrees >= MIN_DEGREES
    step = grey_step(shots)
    measured = np.bincount(index, square, bins)[full] / degrees[full] / 2.0
    variance = without_quantisation(measured / step**2) * step**2
    mean_grey = np.bincount(index, count * mean, bins)[full] / counts[full]
    return VarianceCurve(mean_grey, variance, np.asarray(degrees[full], np.float64), bin_width, step)


def _groups(brightness: Pixels, mean: Pixels, difference: Pixels) -> Array:
    """Pixel count, mean grey and sum of squares of the difference about its mean, by brightness; shape (3, groups)."""
    low, high = float(brightness.min()), float(brightness.max())
    index = ((brightness - low) * ((GROUPS - 1) / max(high - low, 1.0))).astype(np.intp)
    difference = difference.ravel()
    count, shift = np.bincount(index, minlength=GROUPS), np.bincount(index, difference, GROUPS)
    some = count > 1
    square = np.bincount(index, difference**2, GROUPS)[some] - shift[some] ** 2 / count[some]
    return np.stack([count[some], np.bincount(index, mean, GROUPS)[some] / count[some], square])


def quantised(variance: Array) -> Array:
    """The variance (steps squared) that differences of rounded values of that `variance` show, shape (n,).

    Large noise gains 1/12. Small noise gains less: none at all in the limit, where both images round alike. For values
    that lie anywhere between the steps, as those of a scene do, the gain is a Fourier series.
    """
    order = np.arange(1, 1000)[:, np.newaxis]
    damped = np.exp(-4.0 * np.pi**2 * order**2 * variance) / (2.0 * np.pi**2 * order**2)
    return np.asarray(variance + 1.0 / 12.0 - damped.sum(axis=0))


def without_quantisation(variance: Array) -> Array:
    """The inverse of `quantised`."""
    grid = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 400)])
    return np.where(variance > 1.0, variance - 1.0 / 12.0, np.interp(variance, quantised(grid), grid))


DARKEST_STOPS, BRIGHTEST_STOPS = -9.0, 2.0
"""From where the scene's median is half of full scale: to a few electrons a pixel, and until most pixels saturate."""
STEP_STOPS = 0.6
"""A flat scene shows noise at as many levels as there are exposures; at a high gain only a stop of them helps."""
PAIR = 2
HALF = (0.3, 0.7)


def plan_noise(camera: StaticCamera, gain_db: float) -> SweepPlan:
    """Pairs of images at exposure times around that of this scene, and one of them again, to show a light that drifts.

    Raises CameraError when the camera fails.
    """
    shortest_us, longest_us = time_bounds_us(camera.limits)
    half_us = half_exposure_us(camera, gain_db, FIRST_TIME_US)
    low_us = max(half_us * 2.0**DARKEST_STOPS, shortest_us)
    high_us = min(half_us * 2.0**BRIGHTEST_STOPS, longest_us)
    count = max(int(np.ceil(np.log2(high_us / low_us) / STEP_STOPS)) + 1, 2)
    times_us = [float(time_us) for time_us in np.geomspace(low_us, high_us, count)]
    again_us = min(times_us, key=lambda time_us: abs(np.log2(time_us / half_us)))
    return SweepPlan(tuple(ExposureSetting(time_us, gain_db) for time_us in (*times_us, again_us)), PAIR)


def default_gains_db(limits: ExposureLimits) -> tuple[float, ...]:
    """The lowest gain, the highest one, and two between them."""
    low_db, high_db = limits.min_gain_db, limits.max_gain_db
    spread_db = np.linspace(low_db, high_db, 4).round(1).clip(low_db, high_db)  # an end that is rounded may lie outside
    return tuple(float(gain_db) for gain_db in np.unique(spread_db))


def half_exposure_us(camera: StaticCamera, gain_db: float, first_us: float) -> float:
    """The exposure time (us), looked for from `first_us` on, at which the median pixel is about half of full scale."""
    return exposure_us_for(camera, gain_db, percent=50, bright=HALF, white=HALF[1], first_us=first_us)


MARGIN_SIGMAS = 4.0
"""How far from black and saturation grey levels must be for their noise to be complete."""
DITHER = 0.3
"""Noise (in steps between grey levels) needed to smooth out the steps themselves; EMVA 1288 asks for 0.24."""
LINEAR_PART = 0.7
"""Part of the way from black to saturation that EMVA 1288 takes the system gain from."""
SYSTEMATIC = 0.005
"""Relative error of a variance apart from chance: no sensor is more linear, and no single bin may dominate."""
BENT = 0.05
"""Deviation from the straight line of grey over exposure time that no linear sensor shows."""
DARK, WHITE = 0.02, 0.98
"""Parts of full scale, for words about images: nearly black below the one, saturated above the other."""
UNRESOLVED = 0.1
"""Part of the read noise that its error may be."""
SATURATED_PIXELS = 1000
ROUNDS = 6
"""Rounds of choosing bins by the line and drawing the line through them; three settle it."""
MIN_BINS = 8
MIN_SPAN = 0.15
"""Part of the way from black to saturation that grey levels must span for a slope to be measured."""


@dataclass(frozen=True, slots=True, eq=False)
class PhotonTransfer:
    """What the shots at one gain say about noise."""

    model: NoiseModel | None  # None when a finding refuses it
    findings: tuple[Finding, ...]  # reasons not to trust it
    curve: VarianceCurve | None = None  # variance over mean grey, for plots; None when there are no pairs
    used: NDArray[np.bool_] | None = None  # which bins of the curve the line was drawn through


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """``variance = offset + slope * mean``, with the covariance of (offset, slope) and the bins it rests on."""

    offset: float
    slope: float
    covariance: Array
    used: NDArray[np.bool_]

    def at(self, mean: Array | float) -> Array:
        return np.asarray(self.offset + self.slope * np.asarray(mean))

    def error_at(self, mean: float) -> float:
        weights = np.array([1.0, mean])
        return math.sqrt(max(float(weights @ self.covariance @ weights), 0.0))


def photon_transfer(sweep: Sweep) -> PhotonTransfer:
    """Noise parameters from pairs of images of a static scene at several exposure times, all at one gain.

    The scene may be flat or any other. Grey levels must be in proportion to light: noise of another response is
    refused, since what stretches grey levels stretches their noise. For the full well some shots must saturate.
    """
    shots = sweep.shots
    pairs = pairs_of(shots)
    if not pairs:
        return _refused("no_pairs", "no two neighbouring images have the same setting: take at least two of each")
    curve = variance_curve(shots, pairs)
    top_dn = 2.0 ** shots[0].bit_depth - 1.0
    clipped = (curve.mean < DARK * top_dn) | (curve.mean > WHITE * top_dn)
    if not curve.variance.any() and (not clipped.all() or not len(clipped)):
        return _refused("no_noise", "no noise shows: the images of each pair are identical, or have too few pixels")
    saturation_dn = _saturation(curve)
    limit_dn = top_dn if saturation_dn is None else saturation_dn
    lines = fit_light_lines(shots, limit_dn, curve.step)
    if lines is None:
        return PhotonTransfer(None, (_too_few(curve, None, limit_dn),), curve)
    steadiness = judge_steadiness(lines, pairs, curve.variance_at, limit_dn)
    line = _fit_line(curve, lines.black.value, limit_dn)
    if line is None:
        return PhotonTransfer(None, steadiness.refusals or (_too_few(curve, None, limit_dn),), curve)
    findings = [*steadiness.findings, *_findings(curve, line, lines, limit_dn, steadiness)]
    if saturation_dn is None:
        findings.append(_UNSATURATED)
    model = None
    if not any(finding.severity == "refused" for finding in findings):
        model = _model(shots[0], line, lines, saturation_dn)
        findings += _unresolved(model)
    return PhotonTransfer(model, tuple(findings), curve, line.used)


def _refused(reason: str, text: str) -> PhotonTransfer:
    return PhotonTransfer(None, (Finding("refused", reason, text),))


def _saturation(curve: VarianceCurve) -> float | None:
    """The grey level of full pixels: they vary much less than the line of the others says."""
    top = curve.mean[-1]
    middle = (curve.mean > 0.3 * top) & (curve.mean < 0.6 * top)
    rough = _weighted_line(curve, middle if middle.sum() >= 2 else curve.mean < LINEAR_PART * top)
    if rough is None:
        return None
    full = (curve.mean > 0.6 * top) & (curve.variance < 0.5 * rough.at(curve.mean))
    if curve.degrees[full].sum() < SATURATED_PIXELS:
        return None
    counted = np.cumsum(curve.degrees[full])
    return float(curve.mean[full][np.searchsorted(counted, counted[-1] / 2.0)])


def _fit_line(curve: VarianceCurve, black_dn: float, limit_dn: float) -> _Line | None:
    """The line through the bins whose noise is whole: as many sigmas from black and saturation as it takes."""
    span_dn = limit_dn - black_dn
    used = (curve.mean > black_dn + 0.3 * span_dn) & (curve.mean < black_dn + 0.6 * span_dn)
    if used.sum() < 2:
        used = curve.mean < black_dn + LINEAR_PART * span_dn
    low_dn = np.floor(curve.mean / curve.bin_width) * curve.bin_width
    line = None
    for _ in range(ROUNDS):
        line = _weighted_line(curve, used)
        if line is None:
            return None
        sigma = np.sqrt(np.maximum(line.at(curve.mean), 0.0))
        margin = MARGIN_SIGMAS * sigma + curve.step
        used = (low_dn - margin > 0) & (low_dn + curve.bin_width + margin < limit_dn) & (sigma > DITHER * curve.step)
        used &= curve.mean < black_dn + LINEAR_PART * span_dn
    return line


def _weighted_line(curve: VarianceCurve, used: NDArray[np.bool_]) -> _Line | None:
    """Least squares, weighted by the variance of each variance; None when the bins are too few or all alike."""
    if used.sum() < 2 or not curve.variance[used].any():
        return None
    mean, variance = curve.mean[used], curve.variance[used]
    design = np.stack([np.ones_like(mean), mean], axis=1)
    relative = 2.0 / curve.degrees[used] + SYSTEMATIC**2
    expected = variance
    for _ in range(3):  # weights from the line itself: those from measured variances would favour the low ones
        weight = 1.0 / (relative * np.maximum(expected, 1e-3 * variance.max()) ** 2)
        covariance = np.linalg.inv((design * weight[:, np.newaxis]).T @ design)
        offset, slope = covariance @ (design.T @ (weight * variance))
        expected = offset + slope * mean
    spread = float((weight * (variance - expected) ** 2).sum()) / max(len(mean) - 2, 1)
    return _Line(float(offset), float(slope), covariance * max(spread, 1.0), used)


def _findings(
    curve: VarianceCurve, line: _Line, lines: LightLines, limit_dn: float, steadiness: Steadiness
) -> Iterator[Finding]:
    """Whether grey levels are in proportion to light, and cover enough."""
    mean, span_dn = curve.mean[line.used], limit_dn - lines.black.value
    bent = float(np.nan_to_num(np.abs(lines.light(BRIGHT * span_dn))).max())
    if bent > BENT + steadiness.light:
        text = (
            f"grey levels are up to {bent:.0%} off the straight line over exposure time: photon transfer needs a "
            "linear response; switch off gamma, tone curves and automatics"
        )
        yield Finding("refused", "not_linear", text)
    elif len(mean) < MIN_BINS or np.ptp(mean) < MIN_SPAN * span_dn or line.slope <= 0:
        yield _too_few(curve, line, limit_dn)


def _too_few(curve: VarianceCurve, line: _Line | None, limit_dn: float) -> Finding:
    pixels = max(float(curve.degrees.sum()), 1.0)
    saturated = float(curve.degrees[curve.mean > WHITE * limit_dn].sum()) / pixels
    dark = float(curve.degrees[curve.mean < DARK * limit_dn].sum()) / pixels
    measured = curve.mean[line.used] if line is not None else curve.mean[:0]
    reach = f", from {measured[0]:.0f} to {measured[-1]:.0f}" if len(measured) else ""
    text = (
        f"noise can be measured at {len(measured)} steps of grey{reach} ({saturated:.0%} of the pixels are saturated, "
        f"{dark:.0%} nearly black): take more exposures between nearly black and saturated"
    )
    return Finding("refused", "too_few_levels", text)


def _model(shot: Shot, line: _Line, lines: LightLines, saturation_dn: float | None) -> NoiseModel:
    black = lines.black
    gain = Estimate(line.slope, math.sqrt(line.covariance[1, 1]))
    dark_variance = float(line.at(black.value))
    error = math.hypot(line.error_at(black.value), line.slope * black.error)
    dn = _root(dark_variance, error)
    full_well = None
    if saturation_dn is not None:
        electrons = (saturation_dn - black.value) / gain.value
        full_well = Estimate(electrons, electrons * math.hypot(gain.error / gain.value, black.error / saturation_dn))
    return NoiseModel(
        gain_db=shot.setting.gain_db,
        bit_depth=shot.bit_depth,
        system_gain=gain,
        black_level_dn=black,
        read_noise_dn=dn,
        read_noise_e=Estimate(
            dn.value / gain.value, math.hypot(dn.error, dn.value * gain.error / gain.value) / gain.value
        ),
        saturation_dn=saturation_dn,
        full_well_e=full_well,
    )


def _root(variance: float, error: float) -> Estimate:
    """Standard deviation of a variance that may be as small as its own error, or by chance negative."""
    deviation = math.sqrt(max(variance, 0.0))
    return Estimate(deviation, error / (2.0 * max(deviation, math.sqrt(error) / 2.0, 1e-12)))


def _unresolved(model: NoiseModel) -> Iterator[Finding]:
    noise = model.read_noise_e
    if noise.error > UNRESOLVED * noise.value:
        text = (
            f"read noise is {noise.value:.1f} +- {noise.error:.1f} e, too little to resolve at {model.bit_depth} bits "
            f"and {model.gain_db:g} dB: measure with Mono12 or Mono16, or at a higher gain"
        )
        yield Finding("warned", "read_noise_unresolved", text)


_UNSATURATED = Finding(
    "warned", "saturation_unseen", "no image saturates, so the full well is not known: expose longer or add light"
)
