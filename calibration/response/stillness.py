"""Whether light and scene stood still, from shots of one exposure taken at different times."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.document import Finding
from calibration.response.tones import Curve, Tones, exposure_index, grey8, of_exposures
from calibration.sweep import Sweep
from imaging.response import GREY_LEVELS, ResponseFunction, prediction_table

STEADY_STOPS = 0.015
"""Light that varies by less than 1 % (the standard deviation over shots) is steady enough."""

REFUSED_STOPS = 0.05
"""3.5 % of the light, nine grey levels near saturation of a linear sensor."""

EXPLAINED = 0.93
"""Share of the variance that a step or a drift must account for."""
ALIKE = 0.001
"""A step has one parameter, a drift three: a step that explains nearly as much is preferred.

In a sweep up and down again that ends in long exposures, a drift looks like a step in the middle, to half a percent.
"""
LAG_EXPLAINED = 0.2
"""Share that a lagging control must account for: a linear model does not include its limits."""
LAG_SURPRISE = 0.6
"""Apart from how it started, a control repeats itself when the previous exposures repeat; light does not."""
LONG_EXPOSURE_US = 15_000
"""Exposures this long or longer show hardly any flicker of mains."""
FLICKER_CHANGE = 0.5
"""Change from shot to shot, relative to that between any two shots; 1 means no memory."""
FAR_STOPS = 6.5
"""Light that changes by more was switched: neither flicker nor a drift does that within a minute."""
MOST_STEPS = 3
"""Lights may be switched off and on again; with more steps anything could be explained."""
LAGS_SHOTS = (1, 4, 16)
"""Shots that a control may take to follow."""
MID_GREY = 16
"""Groups nearer to the ends of what was seen are poor light meters."""
MOST_STOPS = 4.0
"""Stops up to which a group measures changes of light; beyond its ends the scale is a guess."""
LEAST_GROUPS = 3
"""Fewer groups do not judge a shot, unless there are no more."""
_WORDS = {
    "auto_exposure": "after each change of exposure brightness goes back; switch auto exposure and auto gain off",
    "light_drift": "it drifts; wait until lamps are warm, or shut out daylight",
    "light_step": "it was switched or shaded; keep it as it is",
    "flicker": "it flickers; use a lamp without flicker, or exposures of whole periods of the mains",
}


def judge_light(sweep: Sweep, by_shot: Tones) -> Finding | None:
    """Light that stepped, drifted or flickered, or an automatic function that lags; None if it was steady."""
    light = Light.of(by_shot, *exposure_index(sweep))
    size = light.variation()
    if size < STEADY_STOPS:
        return None
    times = np.array([k if shot.time_s is None else shot.time_s for k, shot in enumerate(sweep.shots)], float)
    reason = _reason(light, times, by_shot.levels)
    text = f"shots of one exposure differ by {light.range():.2f} stops of light: {_WORDS[reason]}"
    return Finding("refused" if size > REFUSED_STOPS or reason == "auto_exposure" else "warned", reason, text)


def judge_switched_light(sweep: Sweep, by_shot: Tones, *, moved: bool) -> Finding | None:
    """Light that changed by far; None if it did not.

    The picture as a whole is looked at, its quantiles: what moves within it leaves them about as bright, but a camera
    that turns from a window to a dark corner does not. So if the scene `moved`, either may be the cause.
    """
    quantiles = replace(by_shot, greys=np.sort(by_shot.greys, axis=1))
    size = Light.of(quantiles, *exposure_index(sweep)).range()
    finding = None if size < FAR_STOPS else judge_light(sweep, quantiles)
    if finding is None or finding.reason != "light_step":
        return None
    text = (
        f"shots of one exposure differ by {size:.2f} stops as a whole: the light was switched, or the camera looked "
        "elsewhere; keep both as they are"
    )
    return replace(finding, text=text) if moved else finding


def _reason(light: Light, times: Curve, levels: Curve) -> str:
    """Which cause accounts for the variation, the simplest first; flicker is what no other cause explains."""
    step = light.explained_by_steps(1)
    drift = light.explained_by(_powers(times))
    far = light.range() > FAR_STOPS
    if max(step, drift) > EXPLAINED:
        return "light_step" if far or step > drift - ALIKE else "light_drift"
    if light.change_between_neighbours() > FLICKER_CHANGE and not far:
        return "flicker"
    long = np.exp2(levels) > LONG_EXPOSURE_US
    only_short = light.variation(~long) > 4.0 * light.variation(long) and light.weights[long].sum() > 0
    if light.explained_by_steps(MOST_STEPS) > EXPLAINED and not only_short:
        return "light_step"
    if light.explained_by(_lags(levels)) > LAG_EXPLAINED and light.surprise() < LAG_SURPRISE:
        return "auto_exposure"
    return "light_step" if far else "flicker"


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """How much more light each shot had than others of its exposure."""

    stops: Curve  # by shot
    weights: Curve  # share of the groups of pixels that could measure it; 0 where it is unknown
    index: NDArray[np.intp]  # which exposure each shot has

    @classmethod
    def of(cls, by_shot: Tones, levels: Curve, index: NDArray[np.intp]) -> Light:
        """Each group of pixels is its own light meter: its grey levels over the exposures of the sweep are its scale.

        The median of the groups counts: a window in the dark has its own light, which lamps do not change.
        """
        usual = of_exposures(by_shot, levels, index).greys
        dark = usual.min() - 1.0
        stops = np.empty(by_shot.greys.shape)
        for group in range(usual.shape[1]):
            scale = np.maximum.accumulate(np.log2(np.maximum(usual[:, group] - dark, 1.0)))
            seen = np.log2(np.maximum(by_shot.greys[:, group] - dark, 1.0))
            stops[:, group] = _beyond_too(seen, scale + 1e-6 * np.arange(len(levels)), levels)
        stops = np.clip(stops - levels[index][:, None], -MOST_STOPS, MOST_STOPS)
        low, high = usual.min() + MID_GREY, usual.max() - MID_GREY
        clear = ((usual > low) & (usual < high))[index] | ((by_shot.greys > low) & (by_shot.greys < high))
        known = (clear.sum(axis=1) >= min(LEAST_GROUPS, clear.shape[1])) & (np.bincount(index)[index] > 1)
        medians = [
            np.median(row[mask]) if any_clear else 0.0 for row, mask, any_clear in zip(stops, clear, known, strict=True)
        ]
        return cls(np.array(medians), np.where(known, clear.mean(axis=1), 0.0), index)

    def variation(self, among: NDArray[np.bool_] | slice = slice(None)) -> float:
        """Standard deviation of the light of shots of one exposure (stops)."""
        square = float(np.sum(self._centred(self.stops[:, None])[among] ** 2))
        return float(np.sqrt(square / max(float(self.weights[among].sum()), 1e-9)))

    def range(self) -> float:
        """From the shot with the least light to that with the most (stops), where it is known."""
        known = self.stops[self.weights > 0]
        return float(np.ptp(known)) if known.size else 0.0

    def surprise(self) -> float:
        """Share of the variance left between shots of the same exposure after the same change; 1 if there are no two.

        Shots of an exposure are distinguished by the exposure before it and by their place after the change.
        """
        histories: list[tuple[int, int, int]] = []
        before, since = -1, 0
        for k, exposure in enumerate(self.index):
            changed = k > 0 and exposure != self.index[k - 1]
            before, since = (int(self.index[k - 1]), 0) if changed else (before, since + 1)
            histories.append((int(exposure), before, since))
        of = np.array([histories.index(history) for history in histories])
        again = np.bincount(of)[of] > 1
        if not again.any():
            return 1.0
        same = Light(self.stops, np.where(again, self.weights, 0.0), of)
        return (same.variation() / max(self.variation(again), 1e-9)) ** 2

    def explained_by(self, causes: Curve) -> float:
        """Share of the variance that causes, shape (shots, causes), account for by least squares."""
        design, seen = self._centred(causes), self._centred(self.stops[:, None]).ravel()
        factors = np.linalg.lstsq(design, seen, rcond=None)[0]
        return 1.0 - float(np.sum((seen - design @ factors) ** 2) / np.sum(seen**2))

    def explained_by_steps(self, most: int) -> float:
        """Share of the variance that a few steps at the best times account for, found one after the other."""
        shots = np.arange(len(self.index))
        causes = np.empty((len(shots), 0))
        best = 0.0
        for _ in range(most):
            tried = [np.column_stack([causes, shots >= k]).astype(float) for k in shots[1:]]
            shares = [self.explained_by(trial) for trial in tried]
            causes = tried[int(np.argmax(shares))]
            best = max(shares)
        return best

    def change_between_neighbours(self) -> float:
        """Mean square change from one shot to the next of its exposure, over twice the variance: 1 without memory."""
        pairs = (np.diff(self.index) == 0) & (self.weights[1:] > 0) & (self.weights[:-1] > 0)
        if not pairs.any():
            return 0.0
        weights = np.minimum(self.weights[1:], self.weights[:-1])[pairs]
        change = float(np.average(np.diff(self.stops)[pairs] ** 2, weights=weights))
        return change / max(2.0 * self.variation() ** 2, 1e-12)

    def _centred(self, values: Curve) -> Curve:
        """Values (shots, columns) less their mean over the shots of one exposure, times the root of the weights."""
        total = np.maximum(np.bincount(self.index, weights=self.weights), 1e-12)
        sums = np.zeros((len(total), values.shape[1]))
        np.add.at(sums, self.index, values * self.weights[:, None])
        return np.asarray((values - (sums / total[:, None])[self.index]) * np.sqrt(self.weights)[:, None])


def _beyond_too(at: Curve, x: Curve, y: Curve) -> Curve:
    """Straight lines between the points (x, y), x increasing, which go on beyond the first and last."""
    low, high = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    return np.asarray(np.interp(at, x, y) + low * np.minimum(at - x[0], 0.0) + high * np.maximum(at - x[-1], 0.0))


def _powers(times: Curve) -> Curve:
    """A slow drift: time, its square and its cube."""
    unit = 2.0 * (times - times.min()) / max(float(np.ptp(times)), 1e-9) - 1.0
    return np.stack([unit, unit**2, unit**3], axis=1)


def _lags(levels: Curve) -> Curve:
    """A control that lags: exposure less its running mean over a few or many shots, one column for each speed."""
    causes = np.empty((len(levels), len(LAGS_SHOTS)))
    for column, shots in enumerate(LAGS_SHOTS):
        mean = levels[0]
        for k, level in enumerate(levels):
            mean += (level - mean) / (1.0 + shots)
            causes[k, column] = level - mean
    return causes


BLOCK_PX = 16
MOVED_CORRELATION = 0.35
"""Correlation between neighbouring pixels of a block's change: 0 for noise, above a half for edges that moved."""
MOVED_GREY = 1.0
"""Root of the covariance between neighbouring pixels: less does not show in medians."""
TEXTURED_GREY = 2.0
"""Standard deviation within a block: with less, nothing shows that it moved."""
SEEN_AGAIN = 0.9
"""Correlation of a block with the same one in the next shot: with less, it is noise as much as texture."""
SHIFTED = 0.3
"""Share of a change that a shift explains, which compression and denoising do not make."""
REPLACED = 0.5
"""Share of the texture that changed, from which no shift is asked for: noise in what is seen again is less."""

Blocks = NDArray[np.float32]

EXPOSURES = 4
"""Blocks examined, those with the most contrast: motion shows in each of them."""


def moved_share(sweep: Sweep) -> float:
    """Share of textured blocks of the image in which something moved; 0 when no exposure was taken twice."""
    _, index = exposure_index(sweep)
    shares = [0.0]
    for first, last in _pairs(sweep, index):
        one, other, after = (
            _blocks(grey8(sweep.shots[k]).astype(np.float32)) for k in (first, last, min(first + 1, last))
        )
        shares.append(_moved(one, other, _correlation(one, after) > SEEN_AGAIN))
    return max(shares)


def moved_share_between_exposures(sweep: Sweep, response: ResponseFunction) -> float:
    """The same for sweeps that took each exposure once: neighbouring exposures, the brighter one predicted darker."""
    levels, index = exposure_index(sweep)
    shares = [0.0]
    for darker in range(len(levels) - 1):
        dark, bright = (sweep.shots[int(np.flatnonzero(index == i)[0])] for i in (darker, darker + 1))
        table = prediction_table(response, float(levels[darker] - levels[darker + 1])).astype(np.float32)
        table[response.saturation - 1 :] = GREY_LEVELS - 1  # clipped, and left out as such
        one, other = _blocks(table[grey8(bright)]), _blocks(grey8(dark).astype(np.float32))
        shares.append(_moved(one, other, np.ones(len(one), bool)))
    return max(shares)


def _pairs(sweep: Sweep, index: NDArray[np.intp]) -> list[tuple[int, int]]:
    """The first and last shots of the exposures whose images show most contrast."""
    pairs = []
    for exposure in range(index.max() + 1):
        shots = np.flatnonzero(index == exposure)
        if len(shots) > 1:
            pairs.append((float(np.std(grey8(sweep.shots[shots[0]])[::4, ::4])), int(shots[0]), int(shots[-1])))
    return [(first, last) for _, first, last in sorted(pairs, reverse=True)[:EXPOSURES]]


def _blocks(image: NDArray[np.float32]) -> Blocks:
    """The image cut into square blocks, shape (blocks, BLOCK_PX, BLOCK_PX)."""
    rows, columns = (size // BLOCK_PX for size in image.shape)
    cut = image[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, columns, BLOCK_PX)
    return cut.swapaxes(1, 2).reshape(-1, BLOCK_PX, BLOCK_PX)


def _moved(one: Blocks, other: Blocks, textured: NDArray[np.bool_]) -> float:
    """Share of the textured, unclipped blocks whose change, apart from their light, is more than noise."""
    if not one.size:  # images smaller than a block
        return 0.0
    low, high = min(one.min(), other.min()), max(one.max(), other.max())
    inside = textured.copy()
    for blocks in (one, other):
        inside &= (blocks.min(axis=(1, 2)) > low + 2) & (blocks.max(axis=(1, 2)) < high - 2)
    inside &= (one.std(axis=(1, 2)) > TEXTURED_GREY) | (other.std(axis=(1, 2)) > TEXTURED_GREY)
    if inside.sum() < 4:
        return 0.0
    one, other = (_centred(blocks[inside]) for blocks in (one, other))
    gain = (one * other).sum(axis=(1, 2), keepdims=True) / np.maximum((one**2).sum(axis=(1, 2), keepdims=True), 1e-3)
    changed = other - gain * one
    variance = np.mean(changed**2, axis=(1, 2))
    across = np.mean(changed[:, :, 1:] * changed[:, :, :-1], axis=(1, 2))
    down = np.mean(changed[:, 1:] * changed[:, :-1], axis=(1, 2))
    covariance = (across + down) / 2
    spread = (covariance > MOVED_CORRELATION * variance) & (covariance > MOVED_GREY**2)
    replaced = variance > REPLACED * other.var(axis=(1, 2))
    return float((spread & (replaced | (_shifted_share(changed, one + other) > SHIFTED))).mean())


def _shifted_share(changed: Blocks, texture: Blocks) -> NDArray[np.float32]:
    """Share of the change in each block that a small shift of its texture explains: a sum of its two gradients."""
    down, across = (gradient.reshape(len(texture), -1) for gradient in np.gradient(texture, axis=(1, 2)))
    flat = changed.reshape(len(changed), -1)
    gradients = np.stack([down, across], axis=1)
    normal = gradients @ gradients.swapaxes(1, 2) + 1e-3 * np.eye(2, dtype=np.float32)
    right = gradients @ flat[:, :, None]
    explained = (right * np.linalg.solve(normal, right)).sum(axis=(1, 2))
    return np.asarray(explained / np.maximum((flat**2).sum(axis=1), 1e-3))


def _correlation(one: Blocks, other: Blocks) -> NDArray[np.float32]:
    one, other = _centred(one), _centred(other)
    product = (one**2).sum(axis=(1, 2)) * (other**2).sum(axis=(1, 2))
    return np.asarray((one * other).sum(axis=(1, 2)) / np.sqrt(np.maximum(product, 1e-3)))


def _centred(blocks: Blocks) -> Blocks:
    return np.asarray(blocks - blocks.mean(axis=(1, 2), keepdims=True))
