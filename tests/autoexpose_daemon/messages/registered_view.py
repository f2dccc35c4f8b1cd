"""A frame of `repeat` as tests send it."""

from __future__ import annotations

import numpy as np

from autoexpose_daemon.messages.inputs import RegisteredView


def registered_view(distance_m: float = 3.5, shift_px: float | None = 12.0) -> RegisteredView:
    """One of 40 matches, 30 of which agree."""
    random = np.random.default_rng(1)
    agreed = np.arange(40) < 30
    shifts_px = np.where(agreed, 12.0 + random.normal(0.0, 1.0, 40), random.uniform(-300.0, 300.0, 40))
    x_px, y_px = random.uniform((0.0, 0.0), (720.0, 540.0), (40, 2)).T.astype(np.float32)
    return RegisteredView(
        1_700_000_000_000_000_000, distance_m, 40.0, 17, shift_px,
        x_px, y_px, shifts_px.astype(np.float32), agreed, 0.4, -0.1, "",
    )  # fmt: skip
