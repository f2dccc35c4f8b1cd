"""The scores of one run, and what two successive frames are worth to each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evaluation.arrays import Floats
from evaluation.stage.camera import LIMITS, Radiance
from evaluation.stage.oracle import LEVELS, LONGEST_TIMES_US
from evaluation.stage.rendering import Stage
from fake_camera.world.sensor import SensorModel
from imaging.exposure import ExposureSetting, linear_gain
from imaging.python310 import exp2

CELLS = 8
LOG2_RADIANCES = np.arange(-14.0, 18.0, 0.25)  # Bins of radiance, lux times reflectance in stops
# Grey levels that detectors need, whatever the noise, as in the objective of our policies; 8 serves as well.
FRONT_END = 6.0
BLUR_PX = 5.0  # In the shrunk image, a blur of this length halves the energy of gradients
GLIMPSE_S = 20e-6  # The shortest exposure: its radiance is the sharpest
LOST = 0.1  # A pair with a smaller share of the most that it could show is lost: as 20 of some 250 matches
_SENSOR = SensorModel()
# Half a stop apart, each split in several ways.
_TRIED = tuple(
    dict.fromkeys(
        LIMITS.realise(level, min(exp2(level), longest_us))
        for level in LEVELS[::4].tolist()
        for longest_us in LONGEST_TIMES_US.tolist()
    )
)

Variances = Floats  # By setting and radiance, (settings, bins); infinite where nothing shows


class SuccessiveFrames:
    """Judges pairs of successive frames of a stage, as far as the left camera is concerned. `stage`: at the second
    frame of each pair; a light that changes between the two is taken to fall on everything."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._frame = -1
        self._energy = np.empty(0)
        self._most = 0.0

    def share(self, first: ExposureSetting, second: ExposureSetting) -> float:
        """Information of the pair that ends here, as a share of the most that one setting for both gives; NaN: none."""
        if self._frame != self._stage.frame:
            self._frame = self._stage.frame
            self._energy = energy_by_radiance(self._stage.radiance("left", GLIMPSE_S))
            before, after = self._variances(self._frame - 1, _TRIED), self._variances(self._frame, _TRIED)
            self._most = float(information(self._energy, before, after).max())
        before, after = self._variances(self._frame - 1, (first,)), self._variances(self._frame, (second,))
        return float(information(self._energy, before, after)[0]) / self._most if self._most > 0 else np.nan

    def _variances(self, frame: int, settings: tuple[ExposureSetting, ...]) -> Variances:
        """Of a frame, by the radiance in the light of the present one."""
        start_s, light = self._stage.start_s(frame), self._stage.light
        now = light.mean_lux(self._stage.start_s(self._frame), GLIMPSE_S)
        times_s = np.array([setting.exposure_time_us * 1e-6 for setting in settings])
        lit = np.array([light.mean_lux(start_s, float(time_s)) / now for time_s in times_s])
        view = self._stage.views["left"]
        blur_px = np.array([view.image_shift_px(start_s, start_s + float(time_s)) / 2 for time_s in times_s])
        gains = np.array([linear_gain(setting.gain_db) for setting in settings])
        return variances(times_s * lit, gains) * (1.0 + (blur_px[:, None] / BLUR_PX) ** 2)


def variances(lit_s: Floats, gains: Floats) -> Variances:
    """Of log2 radiance as seen by settings; `lit_s` is their exposure times the light, in its present unit."""
    electrons = _SENSOR.sensitivity_e_per_lux_s * lit_s[:, None] * np.exp2(LOG2_RADIANCES)
    scale = 255.0 / _SENSOR.full_well_e * gains[:, None]
    grey = scale * electrons
    pixels = 4.0  # of the sensor, in one of the shrunk image
    noise = (scale**2 * (electrons + _SENSOR.read_noise_e**2) + 1 / 12) / pixels + 1 / 12
    return np.where(grey < 255.0, (noise + FRONT_END**2) / (grey * np.log(2)) ** 2, np.inf)


def information(energy: Floats, first: Variances, second: Variances) -> Floats:
    """Of pairs, (settings,), given the energy of gradients by cell and radiance."""
    return np.asarray(np.sqrt(energy @ (1.0 / (first + second)).T).mean(axis=0))


def energy_by_radiance(radiance: Radiance) -> Floats:
    """Mean over each cell's pixels of the energy of gradients in log2 radiance, (cells, bins). It is listed under the
    brightest of the five pixels that a gradient is from: if that is white, it is lost."""
    rows, columns = radiance.shape[0] // 2, radiance.shape[1] // 2
    small = radiance[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).mean(axis=(1, 3))
    logs = np.log2(np.maximum(small, 2.0 ** LOG2_RADIANCES[0]))
    middle = logs[1:-1, 1:-1]
    up, down, left, right = logs[:-2, 1:-1], logs[2:, 1:-1], logs[1:-1, :-2], logs[1:-1, 2:]
    energy = ((down - up) ** 2 + (right - left) ** 2) / 4
    brightest = np.maximum.reduce([middle, up, down, left, right])
    step = LOG2_RADIANCES[1] - LOG2_RADIANCES[0]
    bins = len(LOG2_RADIANCES)
    by_radiance = np.clip(np.rint((brightest - LOG2_RADIANCES[0]) / step), 0, bins - 1).astype(np.int64)
    y, x = (np.arange(size) * CELLS // size for size in energy.shape)
    cell = y[:, None] * CELLS + x[None]
    sums = np.bincount((cell * bins + by_radiance).ravel(), energy.ravel(), CELLS**2 * bins)
    pixels = np.bincount(cell.ravel(), minlength=CELLS**2)
    return np.asarray(sums.reshape(CELLS**2, bins) / pixels[:, None])


SETTLED_RATIO = 0.9
SETTLED_FRAMES = 10  # Settled: at least this share of the oracle's objective for this many frames in a row
STEADY_FRAMES = 30  # The steady state is the last half second
BAD_SHARE = 0.5  # A frame with a larger share of black and saturated pixels is bad


@dataclass(frozen=True, slots=True)
class CourseScore:
    """The scores of one run, over its scored frames."""

    # Frames from the first scored one (after a step: the first exposed entirely after it) to the first of ten in a row
    # that are settled; 0 when the first one is settled, None when the run never settles: it is stuck.
    settle_frames: int | None
    # How far the exposure level went past the oracle's, in the direction from the level of the first scored frame to
    # the oracle's there; 0 when it stayed on its side. Only frames before settling count, and the oracle's level is the
    # middle of its plateau.
    overshoot_stops: float
    steady_std_stops: float  # standard deviation of the exposure level over the last 30 frames
    # metric_ratio_mean, metric_ratio_p05: mean and fifth percentile of M_g as a share of the oracle's.
    metric_ratio_mean: float
    metric_ratio_p05: float
    bad_frame_share: float  # share of frames whose left image is more than half black or saturated
    gain_db_mean: float  # mean gain
    # objective_ratio_mean, objective_ratio_p05: mean and fifth percentile of what the policy maximises, information or
    # M_g, as a share of the oracle's.
    objective_ratio_mean: float
    objective_ratio_p05: float
    # Mean of M_g as a share of the best of all exposure times and gains, however the policy splits.
    any_split_ratio_mean: float
    # Mean information of two successive frames, as a share of the most that one setting for both gives.
    pair_ratio_mean: float
    lost_pair_share: float  # share of pairs with less than a tenth of it


def score(
    *,
    levels: Floats,
    oracle_levels: Floats,
    ratios: Floats,
    metric_ratios: Floats,
    any_split_ratios: Floats,
    pair_ratios: Floats,
    clipped_shares: Floats,
    gains_db: Floats,
    first_scored: int,
) -> CourseScore:
    """The scores of a run; all arrays have shape (frames,), and frames before `first_scored` do not count. `ratios` and
    `oracle_levels` are by what the policy maximises, `metric_ratios` and `any_split_ratios` by M_g, `pair_ratios` by
    the information of pairs. Frames whose ratio is NaN (no exposure shows anything) neither count as settled nor enter
    the ratios."""
    scored = slice(first_scored, None)
    settle = frames_to_settle(ratios[scored])
    by_objective, by_metric, by_any_split, pairs = (
        each[scored][~np.isnan(each[scored])] for each in (ratios, metric_ratios, any_split_ratios, pair_ratios)
    )
    return CourseScore(
        settle_frames=settle, overshoot_stops=overshoot(levels[scored], oracle_levels[scored], settle),
        steady_std_stops=float(levels[-STEADY_FRAMES:].std()), metric_ratio_mean=_mean(by_metric),
        metric_ratio_p05=_worst(by_metric), bad_frame_share=float(np.mean(clipped_shares[scored] > BAD_SHARE)),
        gain_db_mean=float(gains_db[scored].mean()), objective_ratio_mean=_mean(by_objective),
        objective_ratio_p05=_worst(by_objective), any_split_ratio_mean=_mean(by_any_split),
        pair_ratio_mean=_mean(pairs), lost_pair_share=float(np.mean(pairs < LOST)) if pairs.size else 1.0,
    )  # fmt: skip


def _mean(ratios: Floats) -> float:
    return float(ratios.mean()) if ratios.size else 0.0


def _worst(ratios: Floats) -> float:
    return float(np.percentile(ratios, 5)) if ratios.size else 0.0


def frames_to_settle(ratios: Floats) -> int | None:
    """Index of the first of ten ratios in a row of at least 0.9; None when there is no such row."""
    good = np.convolve(ratios >= SETTLED_RATIO, np.ones(SETTLED_FRAMES), "valid") if ratios.size else np.empty(0)
    settled = np.flatnonzero(np.rint(good) == SETTLED_FRAMES)
    return int(settled[0]) if settled.size else None


def overshoot(levels: Floats, oracle_levels: Floats, settle: int | None) -> float:
    """How far (stops) the levels went past the oracle's before settling; see `CourseScore`."""
    end = len(levels) if settle is None else settle + 1
    direction = np.sign(oracle_levels[0] - levels[0])
    beyond = direction * (levels[:end] - oracle_levels[:end])
    return float(max(beyond.max(initial=0.0), 0.0)) if np.isfinite(direction) else 0.0
