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
) -> None: ...
