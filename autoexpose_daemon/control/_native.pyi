import numpy as np
from numpy.typing import NDArray

INSTRUCTION_SETS: tuple[str, ...]

def gradient_sums(
    image: NDArray[np.uint8],
    weights: NDArray[np.uint8],
    words: NDArray[np.uint8] | None = None,
    region: NDArray[np.uint8] | None = None,
    instruction_set: str | None = None,
) -> tuple[int, ...]: ...
def contrast_sums(
    image: NDArray[np.uint8],
    black: int,
    saturated: int,
    energy: NDArray[np.float64],
    count: NDArray[np.float64],
    region: NDArray[np.uint8] | None = None,
    /,
) -> None: ...
def grey_counts(image: NDArray[np.uint8], region: NDArray[np.uint8] | None, counts: NDArray[np.float64], /) -> None: ...
def count_at_most(image: NDArray[np.uint8], grey: int, /) -> int: ...
def sample_greys(
    image: NDArray[np.uint8], stride: int, saturated: NDArray[np.uint8], sampled: NDArray[np.uint8], /
) -> None: ...
def light_change(
    before: NDArray[np.uint8],
    now: NDArray[np.uint8],
    weights: NDArray[np.uint8] | None,
    log_exposure: NDArray[np.float32],
    clipped: NDArray[np.uint8],
    /,
) -> tuple[int, int, float]: ...
def median_shift(
    image: NDArray[np.uint8],
    side: int,
    light_of_sum: NDArray[np.int16],
    before: NDArray[np.int16] | None,
    now: NDArray[np.int16],
    /,
) -> float | None: ...
def best_times(
    levels: NDArray[np.float64],
    shortest: float,
    longest: float,
    least_gain: float,
    greatest_gain: float,
    shot: float,
    read: float,
    pixels: float,
    speed: float,
    scale: float,
    times_us: NDArray[np.float64],
    /,
) -> None: ...
def split_levels(
    levels: NDArray[np.float64],
    times_us: NDArray[np.float64],
    speed: float,
    now_us: float,
    gains: NDArray[np.float64],
    sharp: NDArray[np.float64],
    /,
) -> None: ...
def pass_time(scene: tuple[NDArray[np.float64] | float, ...], kept: float, moved: float, risen: int, /) -> None: ...
def see_frame(
    rules: tuple[float | tuple[float, float], ...],
    scene: tuple[NDArray[np.float64] | float, ...],
    optics: tuple[NDArray[np.float64], NDArray[np.float64], int, float],
    energy: NDArray[np.float64],
    count: NDArray[np.float64],
    level: float,
    gain: float,
    averaged: float,
    by_cell: NDArray[np.float64],
    /,
) -> tuple[float, float, float, float, float]: ...
def sum_light(
    rules: tuple[float | tuple[float, float], ...],
    scene: tuple[NDArray[np.float64] | float, ...],
    pixels: NDArray[np.float64],
    contrast: NDArray[np.float64],
    guessed: NDArray[np.float64],
    guessed_contrast: NDArray[np.float64],
    /,
) -> None: ...
def look_out(
    rules: tuple[float | tuple[float, float], ...],
    scene: tuple[NDArray[np.float64] | float, ...],
    optics: tuple[NDArray[np.float64], NDArray[np.float64], int, float],
    levels: NDArray[np.float64],
    gains: NDArray[np.float64],
    averaged: float,
    noise_share: float,
    by_cell: NDArray[np.float64],
    light: NDArray[np.float64],
    favours: NDArray[np.float64] | None,
    information: NDArray[np.float64],
    favoured: NDArray[np.float64],
    revealed: NDArray[np.float64],
    /,
) -> float: ...
def find_period(changes: NDArray[np.float64], least_frames: int, least_variance: float, residue: float, /) -> int: ...
def weigh_levels(
    information: NDArray[np.float64],
    favoured: NDArray[np.float64] | None,
    revealed: NDArray[np.float64],
    probability: NDArray[np.float64],
    votes: NDArray[np.float64],
    sharp: NDArray[np.float64],
    hope: float,
    least_camera: float,
    steering_share: float,
    served: float,
    worth: NDArray[np.float64],
    look: NDArray[np.float64],
    /,
) -> None: ...
def plan_frames(
    worth: NDArray[np.float64],
    look: NDArray[np.float64],
    light: NDArray[np.float64],
    chances: NDArray[np.float64],
    lowest: float,
    step: float,
    before: float,
    brightness_loss: float,
    lost_below: float,
    lost_cost: float,
    values: NDArray[np.float64],
    looks: NDArray[np.float64],
    /,
) -> None: ...
