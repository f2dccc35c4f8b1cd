from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.picture.image import ImagePreparation, Rectangle, Region
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, StereoPair
from imaging.response import ResponseFunction

from .scene import LIMITS, radiance

SHAPE = (540, 720)
START = ExposureSetting(1000.0, 6.0)
LAMP = (slice(101, 200), slice(301, 420))


def lamp_mask() -> NDArray[np.uint8]:
    mask = np.full(SHAPE, 255, np.uint8)
    mask[LAMP] = 0
    return mask


def frame(lamp: bool) -> Frame:
    grey = np.clip(radiance(3, 1.0, SHAPE) * 40, 0, 255)
    if lamp:
        rng = np.random.default_rng(8)
        grey[LAMP] = 255 * rng.integers(0, 2, grey[LAMP].shape)  # as steep and as bright as can be
    return Frame(grey.astype(np.uint8), 8, 0, 0, 0, 0, START)


def test_no_rectangles_is_the_whole_picture() -> None:
    weights = Region("roi").weights(SHAPE)
    assert weights.shape == (270, 360)
    assert (weights == 255).all()


def test_rectangles_are_painted_in_order_and_the_rest_is_background() -> None:
    rectangles = (Rectangle(0, 0, 720, 200, 0.5), Rectangle(0, 0, 100, 540, 1.0))
    weights = Region("roi", rectangles, background_weight=0.1).weights(SHAPE)
    assert (weights[10, 10], weights[10, 200], weights[200, 200]) == (255, 128, 26)
    assert set(np.unique(weights)) <= {255, 128, 26}


def test_masked_pixels_are_seen_by_no_measure_of_the_prepared_image() -> None:
    """A weight above 0 means: nothing within two pixels depends on a masked pixel."""
    mask = lamp_mask()
    weights = Region("roi", mask=mask).weights(SHAPE)
    dark = np.zeros(SHAPE, np.uint8)
    lit = dark.copy()
    lit[mask == 0] = 255
    touched = ImagePreparation().prepare(lit) > 0
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            assert not (np.roll(touched, (dy, dx), (0, 1)) & (weights > 0)).any()
    assert np.count_nonzero(weights == 0) < 1.4 * np.count_nonzero(mask == 0) / 4


@pytest.mark.parametrize("shape", [(271, 361), (480, 640), (1079, 1919), (1088, 1456), (2048, 2448)])
def test_masked_pixels_are_not_seen_however_frames_are_shrunk(shape: tuple[int, int]) -> None:
    kept = (slice(shape[0] // 3, shape[0] // 2), slice(shape[1] // 3, shape[1] // 2))
    mask = np.zeros(shape, np.uint8)
    mask[kept] = 255
    weights = Region("roi", mask=mask).weights(shape)
    touched = ImagePreparation().prepare(255 - mask) > 0
    assert not (cv2.dilate(touched.astype(np.uint8), np.ones((3, 3), np.uint8)) & (weights > 0)).any()
    assert np.count_nonzero(weights) > 0.7 * weights.size / 36


def test_mask_and_rectangles_multiply() -> None:
    mask = np.full(SHAPE, 51, np.uint8)
    weights = Region("roi", (Rectangle(0, 0, 720, 540, 0.5),), mask=mask).weights(SHAPE)
    assert np.unique(weights).tolist() == [26]


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_a_masked_lamp_no_longer_changes_the_decision(policy_id: str) -> None:
    region = Region("control.roi.left", mask=lamp_mask())

    def decide(lamp: bool, regions: dict[str, Region]) -> object:
        loop = ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, START, regions=regions)
        decisions = [loop.step(StereoPair(0, {"left": frame(lamp), "right": frame(lamp)})) for _ in range(2)]
        return [(d.setting, d.level, d.reason, d.metric, d.saturated_share, d.black_share) for d in decisions]

    sides = {"left": region, "right": region}
    assert decide(True, sides) == decide(False, sides)
    assert decide(True, {}) != decide(False, {})


@pytest.mark.parametrize(
    ("region", "words"),
    [
        (Region("roi", (Rectangle(700, 0, 21, 10, 1.0),)), ["roi: rectangle 0", "721", "720x540"]),
        (Region("roi", mask=np.full((480, 640), 255, np.uint8)), ["roi", "mask is 640x480", "720x540"]),
        (Region("roi", (Rectangle(0, 0, 720, 540, 0.0),)), ["roi", "720x540", "no pixel"]),
        (Region("roi", (Rectangle(300, 300, 4, 4, 1.0),)), ["roi", "no pixel"]),
    ],
)
def test_a_region_that_does_not_fit_is_named(region: Region, words: list[str]) -> None:
    loop = ControlLoop("begin2022", ResponseFunction.linear(), LIMITS, START, regions={"left": region})
    with pytest.raises(ConfigurationError) as caught:
        loop.step(StereoPair(0, {"left": frame(False)}))
    for word in words:
        assert word in str(caught.value)


def test_a_mask_reaches_two_prepared_pixels_and_no_further() -> None:
    mask = np.full(SHAPE, 255, np.uint8)
    mask[200:202, 400:402] = 0  # one prepared pixel, (100, 200)
    rows, columns = np.nonzero(Region("roi", mask=mask).weights(SHAPE) == 0)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (98, 102, 198, 202)
