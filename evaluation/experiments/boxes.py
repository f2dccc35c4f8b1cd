"""Box plots that also show every run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from evaluation.drawing import COLOURS


def boxes(axes: Any, groups: Sequence[ArrayLike], names: Sequence[str]) -> None:
    """One box for each group, with its values side by side over it."""
    black = {"color": COLOURS[6]}
    axes.boxplot(groups, tick_labels=list(names), widths=0.6, showfliers=False, medianprops=black, boxprops=black)
    for place, group in enumerate(groups):
        values = np.asarray(group)
        across = place + 1 + np.linspace(-0.18, 0.18, len(values)) if len(values) > 1 else np.array([place + 1.0])
        axes.plot(across, values, "o", color=COLOURS[0], alpha=0.6, markersize=4)
