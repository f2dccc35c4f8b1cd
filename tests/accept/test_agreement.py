"""The arena's closed loop in virtual time against the demo in real time, by the demo's own definition of settled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fake_camera.world.lighting import LightScript
from tests.accept.replay import replay_demo
from tests.accept.test_demo import FULL, demo

pytestmark = pytest.mark.quiet(FULL)


@pytest.mark.parametrize("policy", ["belief", "neves2009"])
def test_virtual_and_real_time_settle_alike(tmp_path: Path, policy: str) -> None:
    real = demo(tmp_path, 60, "--policy", policy)
    lost_at_start = real["lost"].get("startup", 0)
    first = real["first_trigger"] + lost_at_start
    virtual = replay_demo(
        policy,
        triggers=range(first, first + real["triggers"] - lost_at_start),
        delay_frames=real["delay_frames"],
        light=LightScript.default(),
        seed=0,
        rate_hz=real["rate_hz"],
    )
    settled = [
        (in_reality["frames_to_settle"], simulated.frames_to_settle)
        for in_reality, simulated in zip(real["steps"], virtual, strict=True)
        if in_reality["frames_to_settle"] is not None and simulated.frames_to_settle is not None
    ]
    print(settled)
    assert len(settled) >= 10
    real_median, virtual_median = np.median(settled, axis=0)
    assert abs(real_median - virtual_median) <= 2
