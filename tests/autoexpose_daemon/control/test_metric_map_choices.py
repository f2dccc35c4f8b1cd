"""What the weights and shares of `metric-map` are for, each in closed loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.picture.image import ImagePreparation
from drivers.exposure import ExposureSetting

from .scene import LIMITS, expose, radiance, run
from .test_metric_map import SCENE, START, drive, make, metric, observe, policy, ratios

MOVING_PX = 6.0


def share_of_best(level: float, light: float, scene: NDArray[np.float64]) -> float:
    """Metric of a frame as a share of the best at any level."""
    levels = np.arange(light - 9, light + 5, 0.25)
    return metric(level, light, scene) / max(metric(float(other), light, scene) for other in levels)


def pan(scenes: Sequence[NDArray[np.float64]], light: float = 12.0) -> list[float]:
    """Levels of a moving camera's frames, one scene after the other; each frame shows the previous decision."""
    chosen, setting, levels = policy(), ExposureSetting(4000.0, 0.0), []
    chosen.motion_px = MOVING_PX
    for scene in scenes:
        levels.append(setting.level)
        image = ImagePreparation().prepare(expose(scene, setting, light).grey8())
        target = chosen.decide(observe(image, setting, MOVING_PX))
        setting = LIMITS.realise(LIMITS.clamp_level(target.level), LIMITS.max_time_us)
    return levels


def with_bright_part(dim: NDArray[np.float64], bright: NDArray[np.float64], columns: int) -> NDArray[np.float64]:
    """A scene whose right part is saturated while the left part is well exposed."""
    scene = dim.copy()
    scene[:, -columns:] = bright[:, -columns:]
    return scene


def test_dusk_is_followed_before_the_picture_suffers() -> None:
    """A stop darker in 1.3 s: too slow to be led as a ramp, and never enough in one frame to be a change."""
    lights = [11.0] * 20 + list(np.linspace(11, 14, 240))
    levels = run(make(), lights, START, scene=SCENE)
    assert ratios(levels, lights)[25:].min() > 0.93


def test_frames_of_a_moving_camera_differ_by_at_most_0_4_stop() -> None:
    """Steps of 0.8 cost odometry a quarter of its accuracy: decision 13. Smaller ones would arrive later."""
    targets = drive([15.0] * 12, SCENE, MOVING_PX)
    steps = np.abs(np.diff(targets))
    assert share_of_best(targets[0], 15.0, SCENE) < 0.8
    assert share_of_best(targets[3], 15.0, SCENE) > 0.97
    assert 0.35 < steps.max() <= 0.41  # registration errs by less than 0.01


@pytest.mark.parametrize("change", [-1.0, 1.0])
def test_steps_of_a_moving_camera_are_counted_from_where_the_light_went(change: float) -> None:
    """Following the light, whichever way it goes, keeps frames similar."""
    before, after = drive([12.0] * 20 + [12.0 + change], SCENE, MOVING_PX)[-2:]
    assert abs(after - before - change) <= 0.41
    assert abs(after - before) > 0.7


@pytest.mark.parametrize("light", [16.0, 17.0])
def test_a_moving_camera_does_not_creep_out_of_a_poor_exposure(light: float) -> None:
    """Where points are few anyway, there is little to lose: three frames later it is as good as it gets."""
    scene = radiance(1, 1.0 if light == 16.0 else 1.5)
    targets = drive([light] * 3, scene, MOVING_PX)
    assert 0.3 < share_of_best(targets[0], light, scene) < 0.5
    assert share_of_best(targets[2], light, scene) > 0.9


def test_a_moving_camera_looks_again_into_what_was_blank_a_second_ago() -> None:
    """What a look into saturation has shown is no longer in view when the camera has moved on."""
    around = radiance(1, 0.5)
    blank = with_bright_part(around, np.full_like(around, 2.0**5), 120)
    rich = with_bright_part(around, radiance(2, 0.8) * 2.0**5, 120)
    levels = pan([blank] * 20 + [rich] * 60)
    assert min(levels[:5]) < 9.0  # it has looked once, and found nothing
    assert np.ptp(levels[10:20]) == 0
    assert share_of_best(levels[-1], 12.0, rich) > 0.9


def test_past_a_bare_wall_it_still_knows_what_a_window_may_hide() -> None:
    """A quarter of a second without anything to see, then a window in a faint wall."""
    textured, wall, faint = radiance(1, 0.8), np.ones((136, 180)), radiance(3, 0.05)
    window = with_bright_part(faint, radiance(2, 0.8) * 2.0**6, 60)
    levels = pan([textured] * 12 + [wall] * 15 + [window] * 6)
    assert share_of_best(levels[-6], 12.0, window) < 0.3
    assert share_of_best(levels[-1], 12.0, window) > 0.9
