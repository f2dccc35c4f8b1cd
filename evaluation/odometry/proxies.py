"""Measures of an image that might predict the error of odometry: the seven of Begin & Hunter 2022, section 3.1."""

from __future__ import annotations

from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.metrics.quality import CombinedQuality
from autoexpose_daemon.control.metrics.weighted_gradients import entropy, entropy_weighted_gradient, median_gradient
from autoexpose_daemon.control.picture.image import ImagePreparation
from evaluation.odometry.stereo import images
from evaluation.odometry.stereo_matching import StereoMatcher
from imaging.frames import StereoPair

PROXIES: dict[str, float | None] = {
    "gradient information": -0.73,
    "median gradient": -0.37,
    "entropy": 0.26,
    "entropy-weighted gradient": -0.40,
    "combined quality": -0.26,
    "good stereo matches": 0.02,
    "Lowe ratio": -0.73,
    "gradient information, no gamma": None,
}
"""In the order of Fig. 9, with the paper's correlation with the error, and one that is not in the paper."""


class Proxies:
    """Measures pairs as odometry gets them, median and gamma of 0.3 first, as the paper did.

    Five measures use the left image at control's size; the last one uses it as control sees it.
    """

    def __init__(self) -> None:
        self._preparation = ImagePreparation()
        self._gradient, self._quality = GradientMetric(), CombinedQuality()
        self._matcher = StereoMatcher()

    def measure(self, pair: StereoPair) -> list[float]:
        """One value for each of `PROXIES`; a Lowe ratio of 1 stands for no match."""
        left, right = images(pair)
        image = self._preparation.prepare(left)
        matches = self._matcher.match(left, right)
        lowe = matches.median_lowe_ratio
        return [
            self._gradient.measure(image),
            median_gradient(image),
            entropy(image),
            entropy_weighted_gradient(image),
            self._quality.measure(image),
            float(matches.count),
            1.0 if lowe is None else lowe,
            self._gradient.measure(self._preparation.prepare(pair.reference.grey8())),
        ]
