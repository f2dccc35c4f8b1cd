"""Light scripts: the illumination of the scene over time, with steps, ramps and mains flicker."""

from __future__ import annotations

import math
import reprlib
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from fake_camera.files import read_regular

_MOST_BYTES = 1 << 18


class _PlainLoader(yaml.SafeLoader):
    """YAML without aliases, since nested aliases can expand beyond any memory."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not supported: write out what they stand for")
        return super().compose_node(parent, index)


@dataclass(frozen=True, slots=True)
class Flicker:
    """Light that pulses like a lamp on the mains: a rectified sine of mean 1, mixed with steady light by `depth`.

    `frequency_hz` counts pulses, twice the frequency of the mains; `depth` is 0 for steady light and 1 for light that
    goes out between pulses. Pulses start at time 0.
    """

    frequency_hz: float = 100.0
    depth: float = 1.0

    def integrals(self, start_s: float, end_s: float) -> tuple[float, float]:
        """Exact integrals of the factor, and of the factor times (time - start_s), over [start_s, end_s]."""
        rate = math.pi * self.frequency_hz
        area, moment = 0.0, 0.0
        index, at_s = math.floor(start_s * self.frequency_hz), start_s
        while at_s < end_s:
            until_s = min(max((index + 1) / self.frequency_hz, at_s), end_s)
            # Phases within this pulse, where the sine is positive.
            a, b = rate * at_s - math.pi * index, rate * until_s - math.pi * index
            area += (math.cos(a) - math.cos(b)) / rate
            moment += ((at_s - start_s) * math.cos(a) - (until_s - start_s) * math.cos(b)) / rate
            moment += (math.sin(b) - math.sin(a)) / rate**2
            index, at_s = index + 1, until_s
        length, steady, pulsing = end_s - start_s, 1.0 - self.depth, self.depth * math.pi / 2.0
        return steady * length + pulsing * area, steady * length * length / 2.0 + pulsing * moment


@dataclass(frozen=True, slots=True)
class Change:
    """From `at_s` on the light changes to `lux`: at once, or linearly over `ramp_s`."""

    at_s: float
    lux: float
    ramp_s: float = 0.0


@dataclass(frozen=True, slots=True)
class LightScript:
    """Illumination in lux over the time since the wire's epoch.

    A script's file is YAML; `flicker` and `repeat_s` are optional; without `repeat_s` the last light stays::

        repeat_s: 20                 # start again after this many seconds
        flicker: {frequency_hz: 100, depth: 0.8}
        light:
          - {at_s: 0, lux: 150}      # the first change is at 0
          - {at_s: 4, lux: 1}        # a step
          - {at_s: 8, lux: 50, ramp_s: 3}

    Raises ValueError when times do not increase, the first is not 0, light is negative, or a ramp overlaps the next
    change.
    """

    changes: tuple[Change, ...]
    repeat_s: float | None = None
    flicker: Flicker | None = None

    def __post_init__(self) -> None:
        if not self.changes or self.changes[0].at_s != 0 or self.changes[0].ramp_s != 0:
            raise ValueError("light must begin with a change at at_s 0 without ramp_s")
        for change, following in zip(self.changes, self.changes[1:], strict=False):
            if change.at_s + change.ramp_s > following.at_s or change.at_s == following.at_s:
                raise ValueError(
                    f"light at_s {following.at_s:g} must come after the end of the change at {change.at_s:g} s"
                )
        for change in self.changes:
            if change.lux < 0 or change.ramp_s < 0:
                raise ValueError(f"light at_s {change.at_s:g} must not have a negative lux or ramp_s")
        last = self.changes[-1]
        if self.repeat_s is not None and not self.repeat_s >= last.at_s + last.ramp_s + 1e-3:
            raise ValueError(f"repeat_s {self.repeat_s:g} must be later than the end of the last change")
        if self.flicker and not (0 < self.flicker.frequency_hz <= 1000 and 0 <= self.flicker.depth <= 1):
            raise ValueError("flicker must have a frequency_hz above 0 up to 1000 and a depth from 0 to 1")

    @classmethod
    def default(cls) -> LightScript:
        """Lights going on and off: 150 lux, 1 lux from 4 s, 150 lux again from 8 s, and so on."""
        return cls((Change(0.0, 150.0), Change(4.0, 1.0)), repeat_s=8.0)

    @classmethod
    def from_file(cls, path: Path) -> LightScript:
        """Read a script; raises ValueError with one sentence naming the file and the key."""
        try:
            content = yaml.load(read_regular(path, _MOST_BYTES).decode(), _PlainLoader)
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is not text"
            raise ValueError(f"light script {path} cannot be read: {reason}") from error
        except Exception as error:  # PyYAML raises anything for bad values of tags such as !!int or dates
            raise ValueError(f"light script {path} is not YAML: {' '.join(str(error).split())}") from error
        try:
            return cls._from_mapping(content)
        except ValueError as error:
            raise ValueError(f"light script {path}: {error}") from error

    @classmethod
    def _from_mapping(cls, content: object) -> LightScript:
        top = _fields(content, "the script", {"light"}, {"repeat_s", "flicker"})
        if not isinstance(top["light"], list):
            raise ValueError("light must be a list of changes")
        changes = []
        for index, entry in enumerate(top["light"]):
            where = f"light[{index}]"
            fields = _fields(entry, where, {"at_s", "lux"}, {"ramp_s"})
            changes.append(Change(**{key: _number(value, f"{where}.{key}") for key, value in fields.items()}))
        flicker = None
        if "flicker" in top:
            fields = _fields(top["flicker"], "flicker", set(), {"frequency_hz", "depth"})
            flicker = Flicker(**{key: _number(value, f"flicker.{key}") for key, value in fields.items()})
        repeat_s = _number(top["repeat_s"], "repeat_s") if "repeat_s" in top else None
        return cls(tuple(changes), repeat_s, flicker)

    def lux(self, time_s: float) -> float:
        """Illumination at `time_s`, with flicker averaged out."""
        return self._line(time_s)[0]

    def mean_lux(self, start_s: float, exposure_s: float) -> float:
        """Mean illumination over an exposure (> 0), exact: short exposures see the flicker, long ones average it."""
        total, at_s, end_s = 0.0, start_s, start_s + exposure_s
        while at_s < end_s:
            level, slope, until_s = self._line(at_s)
            until_s = min(until_s, end_s)
            length = until_s - at_s
            area, moment = self.flicker.integrals(at_s, until_s) if self.flicker else (length, length * length / 2.0)
            total += level * area + slope * moment
            at_s = until_s
        return total / (end_s - start_s)

    def _line(self, time_s: float) -> tuple[float, float, float]:
        """Lux at `time_s`, its slope in lux per second, and until when that slope holds."""
        cycle_s = math.floor(time_s / self.repeat_s) * self.repeat_s if self.repeat_s else 0.0
        index = max(bisect_right(self.changes, time_s - cycle_s, key=lambda change: change.at_s) - 1, 0)
        change = self.changes[index]
        since_s = time_s - cycle_s - change.at_s
        # Rounding may put an end just before `time_s`, but time must advance.
        later_s = math.nextafter(time_s, math.inf)
        if 0.0 <= since_s < change.ramp_s:
            before = self.changes[index - 1].lux
            slope = (change.lux - before) / change.ramp_s
            return before + slope * since_s, slope, max(cycle_s + change.at_s + change.ramp_s, later_s)
        if index + 1 < len(self.changes):
            end_s = cycle_s + self.changes[index + 1].at_s
        else:
            end_s = cycle_s + self.repeat_s if self.repeat_s else math.inf
        return change.lux, 0.0, max(end_s, later_s)


def _fields(value: object, where: str, required: set[str], optional: set[str]) -> Mapping[str, Any]:
    """`value` as a mapping with all required keys and no unknown ones."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{where} must be a mapping of {', '.join(sorted(required | optional))}")
    for key in value:
        if key not in required | optional:
            raise ValueError(f"{where} has the unknown key {key!r}: known are {', '.join(sorted(required | optional))}")
    for key in sorted(required - set(value)):
        raise ValueError(f"{where} lacks the key {key!r}")
    return value


def _number(value: object, where: str) -> float:
    try:
        number = math.nan if isinstance(value, bool) or not isinstance(value, int | float) else float(value)
    except OverflowError:  # YAML's integers have no bound
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{where} must be a number, not {reprlib.repr(value)}")
    return number
