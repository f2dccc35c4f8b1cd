"""What the daemon and the consumers of its frames tell each other in JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting

LARGEST_REPORT_BYTES: Final = 1024
"""The five counts of a report take at most 170."""

LAST_COUNT: Final = (1 << 63) - 1
"""The highest count that is believed if another process sends it."""


@dataclass(slots=True)
class ConsumerTally:
    """A consumer's own count of pairs, since it started. Raises ValueError for a count that is not credible."""

    pairs: int = 0  # handed to the consumer
    # frames of the left camera between these pairs, by gaps in its frame id: lost anywhere, for any reason
    missed: int = 0
    lost: int = 0  # pairs that the daemon sent, but that never arrived complete
    too_slow: int = 0  # pairs that arrived, and were replaced by newer ones before the consumer asked
    alone: int = 0  # triggers of which the daemon had no frame of a camera

    def __post_init__(self) -> None:
        counts = (getattr(self, name) for name in self.__slots__)
        if not all(type(count) is int and 0 <= count <= LAST_COUNT for count in counts):
            raise ValueError(f"counts are whole numbers of 0 to {LAST_COUNT}")

    def to_json(self) -> str:
        """The text that is sent to the daemon."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes) -> ConsumerTally | None:
        """The counts in a report; None if it is damaged."""
        if len(text) > LARGEST_REPORT_BYTES:
            return None
        try:
            report = json.loads(text)
            return cls(**{name: report[name] for name in cls.__slots__})
        except (ValueError, TypeError, KeyError, RecursionError):
            return None

    def __str__(self) -> str:
        losses = {"missed": self.missed, "lost": self.lost, "too slow": self.too_slow, "lone frames": self.alone}
        return ", ".join([f"{self.pairs} pairs", *(f"{count} {name}" for name, count in losses.items() if count)])


LARGEST_RESPONSE_BYTES: Final = 1 << 16
"""The 256 numbers of a response function take 6 KB, the largest grid of a vignetting up to 53 KB."""


def response_to_json(response: ResponseFunction, vignetting: Vignetting | None = None) -> str:
    """The message about a camera; `vignetting` None: it is not known."""
    content: dict[str, Any] = {
        "log2_exposure": response.log2_exposure.tolist(),
        "black_level": response.black_level,
        "saturation": response.saturation,
    }
    if vignetting is not None:
        light = vignetting.as_plain()
        if "grid" in light:
            # To six digits: with all of them, a large grid would be too long to be read.
            light["grid"] = [[float(f"{at:.6g}") for at in row] for row in light["grid"]]
        content["vignetting"] = light
    return json.dumps(content)


def response_from_json(text: str | bytes) -> ResponseFunction | None:
    """The response function in a message; None if the message is damaged."""
    try:
        content = _content(text)
        curve = np.array(_numbers(content["log2_exposure"]), np.float64)
        return ResponseFunction(curve, _whole(content["black_level"]), _whole(content["saturation"]))
    except _DAMAGED:
        return None


def vignetting_from_json(text: str | bytes) -> Vignetting | None:
    """The vignetting in a message; None if there is none, or the message is damaged."""
    try:
        light = _content(text)["vignetting"]
        size = width, height = _whole(light["width"]), _whole(light["height"])
        if "grid" in light:
            middle = (width - 1) / 2.0, (height - 1) / 2.0
            return Vignetting(*size, middle, (), tuple(_numbers(row) for row in light["grid"]))
        x, y = _numbers(light["centre_px"])
        return Vignetting(*size, (x, y), _numbers(light["coefficients"]))
    except _DAMAGED:
        return None


_DAMAGED = (ValueError, TypeError, KeyError, OverflowError, RecursionError, ConfigurationError)


def _content(text: str | bytes) -> Any:
    if len(text) > LARGEST_RESPONSE_BYTES:
        raise ValueError("longer than any daemon's")
    return json.loads(text)


def _numbers(values: Any) -> tuple[float, ...]:
    if not all(type(value) in (int, float) for value in values):
        raise ValueError("not all are numbers")
    return tuple(map(float, values))


def _whole(value: Any) -> int:
    if type(value) is not int:
        raise ValueError("not a whole number")
    return value
