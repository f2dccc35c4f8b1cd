"""Motion between frames: what it measures, and that the C extension does what numpy does."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control import _native
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.picture.motion import FarnebackMotion, Motion, TileMotion
from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction

SIXTIETH_NS = 16_666_667
ALL = pytest.mark.parametrize("flow", [FarnebackMotion, TileMotion])


def view(shift_px: int, gain: float = 1.0, noise: float = 0.0) -> NDArray[np.uint8]:
    """A window into blurred noise, moved by `shift_px`, 720x540, as control sees it."""
    rng = np.random.default_rng(5)
    texture = cv2.GaussianBlur(rng.normal(0, 1, (540, 840)), (0, 0), 12)
    scene = np.asarray(texture, np.float64) / texture.std() * 25 + 70
    frame = scene[:, 20 + shift_px : 740 + shift_px] * gain + np.random.default_rng(6).normal(0, 1, (540, 720)) * noise
    return ImagePreparation().prepare(np.clip(frame, 0, 255).astype(np.uint8)).copy()


def speed(
    flow: type[Motion],
    second: NDArray[np.uint8],
    *,
    stops: float = 0.0,
    interval_ns: int = SIXTIETH_NS,
    first: NDArray[np.uint8] | None = None,
) -> float | None:
    motion = flow(ResponseFunction.linear())
    assert motion.measure(view(0) if first is None else first, 720, 10.0, 0) is None
    return motion.measure(second, 720, 10.0 + stops, interval_ns)


@ALL
@pytest.mark.parametrize("shift_px", [0, 4, 8, 16, 24, 32, 40])
def test_pixels_of_full_resolution_per_sixtieth_by_the_true_interval(flow: type[Motion], shift_px: int) -> None:
    found = speed(flow, view(shift_px))
    assert found == pytest.approx(shift_px, rel=0.1, abs=0.1)
    assert speed(flow, view(shift_px), interval_ns=2 * SIXTIETH_NS) == pytest.approx(found / 2)


def test_a_change_of_exposure_is_not_motion() -> None:
    compensated, ignored = speed(FarnebackMotion, view(0, 2.0), stops=1.0), speed(FarnebackMotion, view(0, 2.0))
    assert compensated < 0.5
    assert ignored > 2 * compensated


@pytest.mark.parametrize("stops", [0.0, 1.0])
def test_tiles_take_neither_exposure_nor_light_for_motion(stops: float) -> None:
    assert speed(TileMotion, view(0, 2.0), stops=stops) < 0.3
    assert speed(TileMotion, view(24, 2.0), stops=stops) == pytest.approx(24, rel=0.1)


@pytest.mark.parametrize("shift_px", [8, 24, 40])
def test_tiles_see_in_the_dark_what_farneback_misses(shift_px: int) -> None:
    first, second = view(0, 0.06, 1.5), view(shift_px, 0.06, 1.5)
    assert speed(TileMotion, second, first=first) == pytest.approx(shift_px, rel=0.12)
    assert speed(FarnebackMotion, second, first=first) < shift_px / 2


def test_strips_that_are_too_narrow_are_refused() -> None:
    motion = TileMotion(ResponseFunction.linear())
    for _ in range(2):  # from the first frame on, before anything depends on it, and not only then
        with pytest.raises(ConfigurationError, match="90x12 pixels are too narrow"):
            motion.measure(np.zeros((50, 360), np.uint8), 720, 10.0, 0)


@ALL
@pytest.mark.parametrize("interval_ns", [0, -SIXTIETH_NS, 10**9])
def test_no_speed_across_a_gap_or_a_clock_that_went_back(flow: type[Motion], interval_ns: int) -> None:
    assert speed(flow, view(8), interval_ns=interval_ns) is None


def test_another_size_starts_afresh() -> None:
    motion = FarnebackMotion(ResponseFunction.linear())
    motion.measure(view(0), 720, 10.0, 0)
    assert motion.measure(view(8)[:100, :120].copy(), 240, 10.0, SIXTIETH_NS) is None


Array = NDArray[np.float64]
BRIGHTEST = 900
TILES = [(i, j) for i in range(3) for j in range(4)]


def light_of_sums(side: int) -> NDArray[np.int16]:
    return np.linspace(-30, BRIGHTEST + 20, side * side * 255 + 1).clip(0, BRIGHTEST).astype(np.int16)


def blocks_by_numpy(image: NDArray[np.uint8], side: int) -> NDArray[np.int64]:
    height, width = image.shape[0] // side, image.shape[1] // side
    whole = image[: height * side, : width * side].astype(int).reshape(height, side, width, side)
    return light_of_sums(side)[whole.sum((1, 3))].astype(np.int64)


def shift_by_numpy(before: NDArray[np.int64], now: NDArray[np.int64]) -> float | None:
    """As `median_shift` in C, in blocks."""
    inside = (before > 0) & (before < BRIGHTEST) & (now > 0) & (now < BRIGHTEST)
    if inside.sum() < 0.01 * inside.size:
        return None
    rise = int(np.rint((now - before)[inside].sum() / inside.sum()))
    low, high = max(rise, 0), BRIGHTEST + min(rise, 0)
    sizes = [(blurred((before + rise).clip(low, high)), blurred(now.clip(low, high)))]
    for _ in range(2):
        sizes.append((halved(sizes[-1][0]), halved(sizes[-1][1])))
    whole = searched(*sizes[2])
    tiles = np.tile(whole, (len(TILES), 1))
    for (first, second), steps in ((sizes[1], 2), (sizes[0], 1)):
        whole, tiles = 2 * whole, 2 * tiles
        for _ in range(steps):
            whole, tiles = stepped(first, second, whole, tiles)
    return float(np.median(np.hypot(*tiles.T)))


def blurred(light: NDArray[np.int64]) -> NDArray[np.int64]:
    kernel = (1, 4, 6, 4, 1)
    for _ in range(2):  # across, then down
        padded = np.pad(light, ((0, 0), (2, 2)), mode="edge")
        light = ((sum(k * padded[:, i : i + light.shape[1]] for i, k in enumerate(kernel)) + 8) >> 4).T
    return light


def halved(light: NDArray[np.int64]) -> NDArray[np.int64]:
    height, width = light.shape[0] // 2, light.shape[1] // 2
    sums = light[: 2 * height, : 2 * width].reshape(height, 2, width, 2).sum((1, 3))
    return np.asarray((sums + 2) >> 2)


def searched(before: NDArray[np.int64], now: NDArray[np.int64]) -> Array:
    height, width = now.shape
    found = []
    for down in range(-min(3, height // 2), min(3, height // 2) + 1):
        for across in range(-min(5, width // 2), min(5, width // 2) + 1):
            rows, columns = slice(max(down, 0), height + min(down, 0)), slice(max(across, 0), width + min(across, 0))
            was = before[max(-down, 0) : height - max(down, 0), max(-across, 0) : width - max(across, 0)]
            change = now[rows, columns] - was
            badness = ((change**2).mean() - change.mean() ** 2 + 8.2) * (1 + 0.03 * np.hypot(across, down))
            found.append((badness, across, down))
    return np.array(min(found, key=lambda each: each[0])[1:], np.float64)


def stepped(before: NDArray[np.int64], now: NDArray[np.int64], whole: Array, tiles: Array) -> tuple[Array, Array]:
    each = [equations(before, now, part, np.rint(tile).astype(int)) for part, tile in zip(TILES, tiles, strict=True)]
    squares, products = sum(one[0] for one in each), sum(one[1] for one in each)
    least = 0.16 * max(sum(one[2] for one in each), 1) * np.eye(2)
    whole = np.linalg.solve(squares + least, products + least @ whole)
    drawn = 0.03 / len(TILES) * squares + least / len(TILES)
    found = np.array([np.linalg.solve(one[0] + drawn, one[1] + drawn @ whole) for one in each])
    return whole, found.clip(*np.outer((-1, 1), now.shape[::-1]))


def equations(
    before: NDArray[np.int64], now: NDArray[np.int64], part: tuple[int, int], shift: NDArray[np.int64]
) -> tuple[Array, Array, int]:
    (i, j), (across, down), (height, width) = part, shift, now.shape
    top, bottom = max(i * height // 3, 1 + max(down, 0)), min((i + 1) * height // 3, height - 1 + min(down, 0))
    left, right = max(j * width // 4, 1 + max(across, 0)), min((j + 1) * width // 4, width - 1 + min(across, 0))
    if bottom - top < 2 or right - left < 2:
        return np.zeros((2, 2)), np.zeros(2), 0

    def both(x: int, y: int) -> NDArray[np.int64]:
        was = before[top + y - down : bottom + y - down, left + x - across : right + x - across]
        return now[top + y : bottom + y, left + x : right + x] + was

    gradients = np.stack([both(1, 0) - both(-1, 0), both(0, 1) - both(0, -1)]).reshape(2, -1) / 4
    gradients -= gradients.mean(1, keepdims=True)
    was = before[top - down : bottom - down, left - across : right - across]
    rest = (was - now[top:bottom, left:right]).ravel()
    squares = gradients @ gradients.T
    return squares, gradients @ (rest - rest.mean()) + squares @ shift, rest.size


def texture(seed: int, height: int, width: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    noise = np.asarray(cv2.GaussianBlur(rng.normal(0, 1, (height, width)), (0, 0), rng.uniform(0.5, 12)), np.float64)
    return (noise / noise.std() * rng.uniform(0, 120) + rng.uniform(0, 255)).clip(0, 255).astype(np.uint8)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(16, 68), st.integers(16, 90), st.sampled_from([1, 2, 3, 4]), st.booleans()
)
def test_the_extension_does_what_numpy_does(seed: int, height: int, width: int, side: int, alike: bool) -> None:
    rng = np.random.default_rng(seed)
    reach = rng.integers(0, 25, 2)
    scene = texture(seed, height * side + 25, width * side + 27)
    rows, columns = (size * side + int(rng.integers(side)) for size in (height, width))  # the odd ends do not count
    first, second = scene[:rows, :columns], scene[reach[0] :, reach[1] :]
    second = (second[: first.shape[0], : first.shape[1]] if alike else texture(seed + 1, *first.shape)).copy()
    before, now = np.empty((2, height, width), np.int16)
    assert _native.median_shift(first, side, light_of_sums(side), None, before) is None
    shift = _native.median_shift(second, side, light_of_sums(side), before, now)
    assert before.tolist() == blocks_by_numpy(first, side).tolist()
    assert now.tolist() == blocks_by_numpy(second, side).tolist()
    expected = shift_by_numpy(before.astype(np.int64), now.astype(np.int64))
    assert (shift is None) == (expected is None)
    if expected is not None:
        assert shift == pytest.approx(side * expected, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("angle", range(0, 360, 45))
def test_phase_correlation_agrees(angle: int) -> None:
    x, y = (round(float(18 * turn(np.radians(angle)))) for turn in (np.cos, np.sin))
    scene = texture(angle + 3, 310, 400)
    first, second = scene[20:290, 20:380], scene[20 + y : 290 + y, 20 + x : 380 + x]
    by_phase = np.hypot(*cv2.phaseCorrelate(first.astype(np.float64), second.astype(np.float64))[0])
    assert speed(TileMotion, second, first=first) == pytest.approx(2 * by_phase, rel=0.1)


def test_of_a_texture_that_repeats_itself_the_least_motion_is_taken() -> None:
    bars = np.tile(np.repeat(np.array([40, 160], np.uint8), 40), (270, 5))
    assert speed(TileMotion, bars[:, 6:366], first=bars[:, :360]) == pytest.approx(12, rel=0.25)


@pytest.mark.parametrize("grey", [0, 255])
def test_black_and_white_pictures_say_nothing(grey: int) -> None:
    scene = texture(1, 270, 360)
    flat = np.full_like(scene, grey)
    assert speed(TileMotion, flat, first=scene) is None and speed(TileMotion, scene, first=flat) is None


def test_a_flat_wall_does_not_move() -> None:
    first, second = np.random.default_rng(1).normal(100, 3, (2, 270, 360)).astype(np.uint8)
    assert speed(TileMotion, second, first=first) < 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image": np.zeros((60, 400), np.uint8)}, "16 to 90 blocks"),
        ({"image": np.zeros((80, 364), np.uint8)}, "16 to 90 blocks"),
        ({"side": 0}, "16 to 90 blocks"),
        ({"light": np.zeros(256, np.int16)}, "light_of_sum"),
        ({"light": np.full(4081, 2048, np.int16)}, "light_of_sum"),
        ({"before": np.zeros((20, 21), np.int16)}, "before"),
        ({"before": np.zeros((20, 20))}, "before"),
        ({"now": np.zeros((20, 19), np.int16)}, "now"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, object], message: str) -> None:
    blocks = np.zeros((20, 20), np.int16)
    fitting: dict[str, object] = {"image": np.zeros((80, 80), np.uint8), "side": 4, "light": light_of_sums(4)}
    fitting |= {"before": blocks, "now": blocks.copy()}
    with pytest.raises(ValueError, match=message):
        _native.median_shift(*(fitting | change).values())  # type: ignore[arg-type]
