"""What control sees of a frame: shrunk, weighted by its region, in colour, and how the light changed."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import (
    CONTROL_SIZE,
    FLOW_SIZE,
    ImagePreparation,
    Rectangle,
    Region,
    Shrinking,
    fit,
)
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.registration import LightChange, LightRegistration
from autoexpose_daemon.control.view import View
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.simulation import build_image_source
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.pixels import MOSAIC_SHARE, Layout, PixelFormat, Pixels
from imaging.python310 import exp2
from imaging.response import ResponseFunction

from .scene import LIMITS, LINEAR, drive, expose, radiance


def slow_median(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    padded = np.pad(image, 1, mode="edge")
    height, width = image.shape
    windows = [padded[j : j + height, i : i + width] for j in range(3) for i in range(3)]
    return np.median(windows, axis=0).astype(np.uint8)


def test_half_size_is_the_mean_of_four_then_the_median_of_nine() -> None:
    frame = np.random.default_rng(1).integers(0, 256, (540, 720)).astype(np.uint8)
    quads = frame.reshape(270, 2, 360, 2).sum(axis=(1, 3))
    small = ((quads + 2) // 4).astype(np.uint8)
    prepared = ImagePreparation().prepare(frame)
    assert prepared.shape == (270, 360)
    assert np.array_equal(prepared, slow_median(small))


@pytest.mark.parametrize(
    ("shape", "control", "flow"),
    [
        ((540, 720), (360, 270), (90, 68)),
        ((1080, 1440), (360, 270), (90, 68)),
        ((512, 640), (338, 270), (85, 68)),
        ((600, 1920), (360, 112), (90, 28)),
        ((68, 90), (90, 68), (90, 68)),
    ],
)
def test_the_whole_scene_fits(shape: tuple[int, int], control: tuple[int, int], flow: tuple[int, int]) -> None:
    assert fit(shape, CONTROL_SIZE) == control
    assert fit(shape, FLOW_SIZE) == flow
    assert ImagePreparation().prepare(np.zeros(shape, np.uint8)).shape == control[::-1]


@pytest.mark.parametrize("shape", [(480, 640), (1024, 1280), (1080, 1440), (1200, 1920), (1537, 2049), (2048, 2448)])
def test_any_ratio_is_close_to_an_average_by_area(shape: tuple[int, int]) -> None:
    texture = cv2.GaussianBlur(np.random.default_rng(1).normal(0, 300, shape), (0, 0), 3.0) * 2 + 120
    frame, size = np.clip(texture, 0, 255).astype(np.uint8), fit(shape, CONTROL_SIZE)
    small = Shrinking(shape, size).shrink(frame)
    averaged = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
    assert small.shape == averaged.shape
    # OpenCV interpolates 0.15 too dark on x86-64, but not on arm64; halving rounds up.
    assert small.mean() == pytest.approx(averaged.mean(), abs=0.5)
    assert small.std() == pytest.approx(averaged.std(), rel=0.07)
    assert np.corrcoef(small.ravel(), averaged.ravel())[0, 1] > 0.98


def test_no_pixel_is_passed_over() -> None:
    frame = np.zeros((1024, 1280), np.uint8)
    frame[:, 1::40] = 255  # lines of one pixel, at all places between the pixels of the small image
    small = Shrinking(frame.shape, fit(frame.shape, CONTROL_SIZE)).shrink(frame)
    assert small.mean() == pytest.approx(frame.mean(), rel=0.05)
    for line in range(1, 1280, 40):
        place = int((line + 0.5) / 1280 * 338)
        assert small[0, max(place - 1, 0) : place + 2].sum() == pytest.approx(255 * 338 / 1280, rel=0.1)


def test_an_image_of_the_size_stays_as_it_is() -> None:
    frame = np.random.default_rng(1).integers(0, 256, (270, 360, 3)).astype(np.uint8)
    assert Shrinking(frame.shape, (360, 270)).shrink(frame) is frame
    assert Shrinking(frame.shape, (90, 68)).shrink(frame).shape == (68, 90, 3)


def test_a_frame_too_small_is_refused_with_its_size() -> None:
    with pytest.raises(ConfigurationError, match="89x68"):
        ImagePreparation().prepare(np.zeros((68, 89), np.uint8))


SHAPE = (540, 720)
START = ExposureSetting(1000.0, 6.0)
LAMP = (slice(101, 200), slice(301, 420))


def lamp_frame(lamp: bool) -> Frame:
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


@pytest.mark.parametrize("shape", [SHAPE, (271, 361), (480, 640), (1079, 1919), (1088, 1456), (2048, 2448)])
def test_masked_pixels_are_not_seen_however_frames_are_shrunk(shape: tuple[int, int]) -> None:
    """A weight above 0 means: nothing within two pixels depends on a masked pixel."""
    kept = (slice(shape[0] // 3, shape[0] // 2), slice(shape[1] // 3, shape[1] // 2))
    mask = np.zeros(shape, np.uint8)
    mask[kept] = 255
    weights = Region("roi", mask=mask).weights(shape)
    touched = ImagePreparation().prepare(255 - mask) > 0
    assert not (cv2.dilate(touched.astype(np.uint8), np.ones((3, 3), np.uint8)) & (weights > 0)).any()
    assert np.count_nonzero(weights) > 0.7 * weights.size / 36


def test_a_mask_reaches_two_prepared_pixels_and_no_further() -> None:
    mask = np.full(SHAPE, 255, np.uint8)
    mask[200:202, 400:402] = 0  # one prepared pixel, (100, 200)
    rows, columns = np.nonzero(Region("roi", mask=mask).weights(SHAPE) == 0)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (98, 102, 198, 202)


def test_mask_and_rectangles_multiply() -> None:
    mask = np.full(SHAPE, 51, np.uint8)
    weights = Region("roi", (Rectangle(0, 0, 720, 540, 0.5),), mask=mask).weights(SHAPE)
    assert np.unique(weights).tolist() == [26]


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_a_masked_lamp_no_longer_changes_the_decision(policy_id: str) -> None:
    mask = np.full(SHAPE, 255, np.uint8)
    mask[LAMP] = 0
    region = Region("control.roi.left", mask=mask)

    def decide(lamp: bool, regions: dict[str, Region]) -> object:
        loop = ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, START, regions=regions)
        decisions = [loop.step(FrameSet(0, {"left": lamp_frame(lamp), "right": lamp_frame(lamp)})) for _ in range(2)]
        return [(d.setting, d.level, d.reason, d.metric, d.saturated_share, d.black_share) for d in decisions]

    cameras = {"left": region, "right": region}
    assert decide(True, cameras) == decide(False, cameras)
    assert decide(True, {}) != decide(False, {})


@pytest.mark.parametrize(
    ("region", "words"),
    [
        (Region("roi", (Rectangle(700, 0, 21, 10, 1.0),)), ["roi: rectangle 0", "721", "720x540"]),
        (Region("roi", mask=np.full((480, 640), 255, np.uint8)), ["roi", "mask is 640x480", "720x540"]),
        (Region("roi", (Rectangle(0, 0, 720, 540, 0.0),)), ["roi", "no pixel", "720x540"]),
        (Region("roi", (Rectangle(300, 300, 4, 4, 1.0),)), ["roi", "no pixel"]),
    ],
)
def test_a_region_that_does_not_fit_is_named(region: Region, words: list[str]) -> None:
    loop = ControlLoop("begin2022", ResponseFunction.linear(), LIMITS, START, regions={"left": region})
    with pytest.raises(ConfigurationError, match=".*".join(words)):
        loop.step(FrameSet(0, {"left": lamp_frame(False)}))


LONG = ExposureSetting(2000.0, 0.0)
LUX = (150.0, 3.0)
HOLD_FRAMES = 10
PERIOD_S = 1 / 30
GREEN = 60


def decide(pixels: Pixels, layout: Layout, response: ResponseFunction = LINEAR, region: Region | None = None) -> float:
    """The saturated share that control sees."""
    frame = Frame(pixels, 8, 0, 0, 0, 0, LONG, layout=layout)
    regions = {} if region is None else {"left": region}
    loop = ControlLoop("belief", response, LIMITS, LONG, regions=regions)
    return loop.step(FrameSet(0, {"left": frame})).saturated_share


def sign(shape: tuple[int, int], red: int) -> Pixels:
    """An RGGB mosaic of a wall with a red sign on its left quarter."""
    mosaic = np.full(shape, GREEN, np.uint8)
    mosaic[::2, : shape[1] // 4 : 2] = red
    return mosaic


@pytest.mark.parametrize(("layout", "counted"), [("grey", 1.0), ("RGGB", MOSAIC_SHARE)])
@pytest.mark.parametrize("width", [640, 1280])
def test_a_look_says_how_many_samples_were_averaged_into_each_of_its_pixels(
    width: int, layout: Layout, counted: float
) -> None:
    shape = (3 * width // 4, width)
    frame = Frame(np.full(shape, GREEN, np.uint8), 8, 0, 0, 0, 0, LONG, layout=layout)
    look = View(LINEAR).look("left", frame)
    assert look.averaged == pytest.approx(counted * frame.pixels.size / look.image.size)


@pytest.mark.parametrize("shape", [(540, 720), (480, 640)])
def test_a_saturated_red_sign_is_saturated(shape: tuple[int, int]) -> None:
    assert decide(sign(shape, 254), "RGGB") == 0
    assert decide(sign(shape, 255), "RGGB") == pytest.approx(0.25, abs=0.01)
    rgb = np.full((*shape, 3), GREEN, np.uint8)
    rgb[:, : shape[1] // 4, 0] = 255
    assert decide(rgb, "RGB") == pytest.approx(0.25, abs=0.01)


def test_saturation_is_that_of_the_response() -> None:
    response = replace(LINEAR, saturation=230)
    assert decide(sign((540, 720), 229), "RGGB", response) == 0
    assert decide(sign((540, 720), 230), "RGGB", response) == pytest.approx(0.25, abs=0.01)


@pytest.mark.parametrize("shape", [(540, 720), (480, 640)])
def test_regions_are_in_pixels_of_the_frames(shape: tuple[int, int]) -> None:
    left, right = (Region("roi", (Rectangle(x, 0, shape[1] // 4, shape[0], 1.0),)) for x in (0, shape[1] // 2))
    assert decide(sign(shape, 255), "RGGB", region=left) > 0.98
    assert decide(sign(shape, 255), "RGGB", region=right) == 0


def metric_ratio(pixel_format: PixelFormat) -> float:
    """In closed loop through two lights: the metric reached, relative to that of the best level; mean of the lights."""
    hold_s = HOLD_FRAMES * PERIOD_S
    light = LightScript(tuple(Change(index * hold_s, lux) for index, lux in enumerate(LUX)))
    camera = build_image_source("room", "left", light, seed=0, still=True)
    metric, preparation = GradientMetric(), ImagePreparation()

    def frame(number: int, setting: ExposureSetting) -> Frame:
        image = ImageSettings(
            setting.exposure_time_us, setting.gain_db, 0.0, 1.0, pixel_format.value, 0, 0, 720, 540, 1, 1
        )
        pixels, time_ns = camera.take(number * PERIOD_S, image, number), round(number * PERIOD_S * 1e9)
        return Frame(
            pixels, pixel_format.bit_depth, number, time_ns, time_ns, time_ns, setting, layout=pixel_format.layout
        )

    def measured(taken: Frame) -> float:
        return metric.measure(preparation.prepare(taken.grey8()))

    def take(number: int, setting: ExposureSetting) -> FrameSet:
        taken = frame(number, setting)
        if (number + 1) % HOLD_FRAMES == 0:
            levels = setting.level + np.arange(-1.5, 1.6, 0.25)
            others = [measured(frame(number, LIMITS.realise(level, exp2(level)))) for level in levels]
            ratios.append(measured(taken) / max(measured(taken), *others))
        return FrameSet(number, {"left": taken})

    ratios: list[float] = []
    drive(ControlLoop("belief", LINEAR, LIMITS, LONG), len(LUX) * HOLD_FRAMES, take, start=LONG)
    return float(np.mean(ratios))


def test_a_bayer_rig_is_exposed_as_well_as_a_grey_one() -> None:
    assert metric_ratio(PixelFormat.BAYER_RG8) > metric_ratio(PixelFormat.MONO8) - 0.02


def noisy(level: float, half_scale_level: float, noise: float = 0.0, seed: int = 0) -> NDArray[np.uint8]:
    grey = expose(radiance(4, 1.0, (270, 360)), ExposureSetting(float(2.0**level), 0.0), half_scale_level).grey8()
    noisy = grey + np.random.default_rng(seed).normal(0.0, noise, grey.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def change_of_light(
    before: NDArray[np.uint8],
    now: NDArray[np.uint8],
    level_change: float = 0.0,
    weights: NDArray[np.uint8] | None = None,
) -> LightChange | None:
    registration = LightRegistration({"left": LINEAR})
    assert registration.change(Look("left", before, LINEAR, weights), 11.0) is None
    return registration.change(Look("left", now, LINEAR, weights), 11.0 + level_change)


def test_the_edge_between_white_and_black_says_nothing_of_the_light() -> None:
    """It is grey at any exposure, and where all else is clipped nothing outvotes it."""
    picture = np.zeros((270, 360), np.uint8)
    picture[:, 180:] = 255
    picture[:, 179:181] = 127
    change = change_of_light(picture, picture, 3.0)
    assert change is None or not change.measured


@pytest.mark.parametrize(("change", "level_change"), [(0.0, 1.5), (0.7, 0.0), (-1.0, 1.0), (2.0, -1.0)])
def test_registration_separates_light_from_exposure(change: float, level_change: float) -> None:
    light = change_of_light(noisy(11.0, 11.5), noisy(11.0 + level_change, 11.5 - change), level_change)
    assert light == LightChange(pytest.approx(change, abs=0.05), True)


def test_registration_is_not_misled_by_the_noise_of_the_unclipped_rest() -> None:
    """After a drop of 5.5 stops only noise peaks are unclipped in both frames; they alone would give about half."""
    light = change_of_light(noisy(11.0, 10.0), noisy(11.0, 15.5, noise=4.0))
    assert light is not None and light.stops < -3.5


def test_registration_says_when_it_has_only_a_bound() -> None:
    light = change_of_light(noisy(11.0, 12.0), np.full((270, 360), 255, np.uint8))
    assert light is not None and not light.measured and light.stops > 1


def test_registration_ignores_masked_pixels() -> None:
    weights, before, brighter = np.full((270, 360), 255, np.uint8), noisy(11.0, 11.5), noisy(11.0, 10.5)
    weights[:, :250] = 0
    brighter[:, 250:] = before[:, 250:]
    light = change_of_light(before, brighter, weights=weights)
    assert light is not None and light.stops == pytest.approx(0.0, abs=0.02)
