"""Spectra of how often features are seen (FreMEn: Krajnik et al. 2017, as used by Majer et al. 2018, 3.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imaging.python310 import Self

DAY_S = 86_400.0

PERIODS_S = tuple(DAY_S / harmonic for harmonic in range(1, 6))
"""A day and its harmonics. The paper's experiment looks for the day only, later works for 14 harmonics of a week."""

LEAST, MOST = 0.01, 0.99
"""Bounds of a probability."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Running sums over passings, for n features and K periods; adding them one by one gives the same as all at once.

    Attributes
    ----------
    periods_s
        float64, (K,).
    passings, seen
        How often each feature was looked for, and seen, float64, (n,).
    all_cos, all_sin
        Sums of cosine and sine over the times at which it was looked for, float64, (n, K).
    seen_cos, seen_sin
        The same over the times at which it was seen.
    """

    periods_s: NDArray[np.float64]
    passings: NDArray[np.float64]
    seen: NDArray[np.float64]
    all_cos: NDArray[np.float64]
    all_sin: NDArray[np.float64]
    seen_cos: NDArray[np.float64]
    seen_sin: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        times_s: NDArray[np.float64],
        seen: NDArray[np.float64],
        passed: NDArray[np.bool_],
        periods_s: tuple[float, ...] = PERIODS_S,
    ) -> Self:
        """From passings at `times_s`, (d,); whether features were `seen` (0 or 1) and looked for (`passed`), (d, n)."""
        periods, looked_for = np.array(periods_s), passed.astype(np.float64)
        phases = 2 * np.pi * times_s[:, None] / periods
        cos, sin = np.cos(phases), np.sin(phases)
        counted = seen * looked_for
        return cls(
            periods, looked_for.sum(axis=0), counted.sum(axis=0),
            looked_for.T @ cos, looked_for.T @ sin, counted.T @ cos, counted.T @ sin,
        )  # fmt: skip

    def with_passing(self, time_s: float, seen: NDArray[np.float64], passed: NDArray[np.bool_]) -> Spectrum:
        """The sums after one more passing; `seen` and `passed` have shape (n,)."""
        one = Spectrum.of(np.array([time_s]), seen[None], passed[None], tuple(self.periods_s.tolist()))
        return Spectrum(
            self.periods_s, self.passings + one.passings, self.seen + one.seen,
            self.all_cos + one.all_cos, self.all_sin + one.all_sin,
            self.seen_cos + one.seen_cos, self.seen_sin + one.seen_sin,
        )  # fmt: skip

    def probability(self, time_s: float, order: int) -> NDArray[np.float64]:
        """How likely each feature is to be seen at a time, by its mean and `order` strongest periods, float64, (n,)."""
        count = np.maximum(self.passings, 1.0)[:, None]
        mean = self.seen[:, None] / count
        cosine = (self.seen_cos - mean * self.all_cos) / count
        sine = (self.seen_sin - mean * self.all_sin) / count
        amplitude = np.hypot(cosine, sine)
        wave = 2.0 * amplitude * np.cos(2 * np.pi * time_s / self.periods_s - np.arctan2(sine, cosine))
        strongest = np.argsort(-amplitude, axis=1, kind="stable")[:, :order]
        sums = mean[:, 0] + np.take_along_axis(wave, strongest, axis=1).sum(axis=1)
        return np.asarray(sums.clip(LEAST, MOST))
