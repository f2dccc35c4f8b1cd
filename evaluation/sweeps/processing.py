"""What cameras do to an image before they hand it out: JPEG, denoising, and a consumer's colours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import cv2
import numpy as np

from imaging.pixels import Pixels

Processing = Literal["raw", "jpeg 75", "jpeg 85", "jpeg 95", "median", "bilateral", "nlm", "colour"]
PROCESSINGS: tuple[Processing, ...] = ("jpeg 75", "jpeg 85", "jpeg 95", "median", "bilateral", "nlm", "colour")
"""Those that leave no noise of photons; "colour" is three channels that mix, as JPEG of one of those qualities."""

Process = Callable[[Pixels], Pixels]

GREEN = 1


def process_of(processing: Processing, rng: np.random.Generator) -> Process:
    """What is done to every image of a sweep, one channel or three; its strength is drawn once."""
    match processing:
        case "raw":
            return lambda image: image
        case "median":
            return lambda image: cv2.medianBlur(image, 3).astype(np.uint8)
        case "bilateral":
            colour, space = float(rng.uniform(8.0, 40.0)), float(rng.uniform(1.0, 3.0))
            return lambda image: cv2.bilateralFilter(image, 7, colour, space).astype(np.uint8)
        case "nlm":
            strength = float(rng.uniform(3.0, 10.0))
            return lambda image: cv2.fastNlMeansDenoising(image, np.empty_like(image), strength, 5, 11).astype(np.uint8)
        case "colour":
            return _jpeg(int(rng.choice([75, 85, 95])))
        case _:
            return _jpeg(int(processing.split()[1]))


def _jpeg(quality: int) -> Process:
    """OpenCV's encoder halves the resolution of chroma (4:2:0)."""

    def process(image: Pixels) -> Pixels:
        _, code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(code, cv2.IMREAD_UNCHANGED), np.uint8)

    return process
