"""The gain of a camera in dB: looks at many gains, the scale that follows, whether to believe it, and its file."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from calibration.document import (
    CalibrationDocument,
    Finding,
    MeasuredFile,
    Name,
    Number,
    optional,
    read_document,
    within,
    write_document,
)
from calibration.noise.photon_transfer import half_exposure_us
from calibration.sweep import FIRST_TIME_US, Shot, StaticCamera
from documents.bounds import GAIN_DB, Range
from imaging.exposure import DB_PER_STOP, ExposureSetting
from imaging.gain_scale import GainScale
from imaging.python310 import Self

FORMAT = "autoexpose-gain/1"
_ERROR_DB = Range(0.0, 100.0, "dB")
_SETTING = Range(-1e9, 1e9)
_Gain = Annotated[Number, within(GAIN_DB)]
_Setting = Annotated[Number, within(_SETTING)]


@dataclass(frozen=True, slots=True)
class GainFile(MeasuredFile):
    """The scale of a gain, the camera it belongs to, and how well it is known."""

    scale: GainScale
    error_db: float | None = None  # how far any gain may be from the truth; None: the file does not say

    @classmethod
    def load(cls, path: Path) -> GainFile:
        """Read a gain file. Raises ConfigurationError naming the file, the key and what to do."""
        document = read_document(_Document, path, FORMAT)
        scale = GainScale(document.node, document.settings, document.gains_db)
        return cls(scale, document.error_db, **document.measured(path))

    def save(self, path: Path) -> None:
        """Write the file. Raises ConfigurationError when it cannot be written."""
        document = {
            "format": FORMAT,
            "camera": self.camera and asdict(self.camera),
            "node": self.scale.node,
            "date": self.date,
            "tool": self.tool,
            "error_db": self.error_db,
            "findings": [asdict(finding) for finding in self.findings],
            "settings": list(self.scale.settings),
            "gains_db": [round(gain_db, 4) for gain_db in self.scale.gains_db],
        }
        write_document(path, document)

    def check_belongs(self, serial: str) -> None:
        """Refuse a file of another camera. Raises ConfigurationError naming file, camera and what to do."""
        self.check_camera(serial, "gain")


class _Document(CalibrationDocument):
    """All keys of a gain file."""

    format: Literal["autoexpose-gain/1"] = Field(description=f"only {FORMAT!r} can be read")
    node: Name = Field(description="give the name of the gain's node")
    error_db: Annotated[Number, within(_ERROR_DB)] | None = optional(f"give {_ERROR_DB}")
    settings: Annotated[tuple[_Setting, ...], Field(min_length=2)] = Field(
        description=f"give two or more numbers that rise, of {_SETTING}"
    )
    gains_db: Annotated[tuple[_Gain, ...], Field(min_length=2)] = Field(
        description=f"give two or more numbers that rise, of {GAIN_DB}"
    )

    @model_validator(mode="after")
    def _is_a_scale(self) -> Self:
        if len(self.settings) != len(self.gains_db):
            raise ValueError(f"{len(self.settings)} settings for {len(self.gains_db)} gains_db: give as many")
        if any(after <= before for before, after in zip(self.settings, self.settings[1:], strict=False)):
            raise ValueError("settings must rise from one to the next: measure them again")
        falls = any(after < before for before, after in zip(self.gains_db, self.gains_db[1:], strict=False))
        if falls or self.gains_db[0] == self.gains_db[-1]:
            raise ValueError("gains_db must rise with settings, and may not fall: measure them again")
        return self


Array = NDArray[np.float64]

FRAMES = 4
"""Frames of each exposure time: they average flicker and noise."""
SHORT = 0.4
"""The shorter exposure time as a part of the longer. Their difference is free of the black level, which may move with
the gain."""
PATCH_PX = 16
LEAST_RISE = 0.03
"""Part of full scale by which a patch must rise between the two exposure times: less is noise."""
LEAST_PATCHES = 0.02
"""Part of the picture that must be neither black nor saturated at both exposure times."""


@dataclass(frozen=True, slots=True, eq=False)
class GainLook:
    """What was seen at one gain."""

    number: float  # the gain, in the camera's own numbers
    time_us: float  # the longer exposure time
    slopes: Array  # part of full scale per us, of each patch, shape (patches,); NaN where it was clipped or hardly lit

    def gain_db(self, reference: GainLook) -> float:
        """Its gain above that of another look at the same scene; NaN where too little was seen in both."""
        ratios = self._ratios(reference)
        return float(DB_PER_STOP * np.log2(np.median(ratios))) if len(ratios) else float("nan")

    def unevenness(self, reference: GainLook) -> float:
        """How far the patches disagree about that, as a part: the median deviation from their median."""
        ratios = self._ratios(reference)
        return float(np.median(np.abs(ratios / np.median(ratios) - 1.0))) if len(ratios) else float("nan")

    def _ratios(self, reference: GainLook) -> Array:
        both = np.isfinite(self.slopes) & np.isfinite(reference.slopes)
        few = both.sum() < max(LEAST_PATCHES * both.size, 1)
        return np.empty(0) if few else self.slopes[both] / reference.slopes[both]


def look_near(camera: StaticCamera, number: float, time_us: float) -> GainLook:
    """A look with the exposure time, searched from `time_us` on, at which the scene is about half bright."""
    return look(camera, number, half_exposure_us(camera, number, time_us))


def look(camera: StaticCamera, number: float, time_us: float) -> GainLook:
    """A look with that exposure time and a shorter one."""
    long_us, long = _patches(camera.take(ExposureSetting(time_us, number), FRAMES))
    short_us = max(time_us * SHORT, camera.limits.min_time_us)
    short_us, short = _patches(camera.take(ExposureSetting(short_us, number), FRAMES))
    lit = (long - short > LEAST_RISE) & (long_us > short_us)
    slopes = np.full_like(long, np.nan)
    slopes[lit] = (long - short)[lit] / (long_us - short_us)
    return GainLook(number, time_us, slopes)


def _patches(shots: Sequence[Shot]) -> tuple[float, Array]:
    """Exposure time, and mean grey, as a part of full scale, of each patch that no shot has clipped anywhere."""
    full = 2 ** shots[0].bit_depth - 1
    height, width = (size // PATCH_PX * PATCH_PX for size in shots[0].pixels.shape)
    grey = np.zeros((height // PATCH_PX) * (width // PATCH_PX))
    for shot in shots:
        blocks = shot.pixels[:height, :width].reshape(height // PATCH_PX, PATCH_PX, width // PATCH_PX, PATCH_PX)
        clipped = (blocks.min(axis=(1, 3)) <= 0) | (blocks.max(axis=(1, 3)) >= full)
        grey += np.where(clipped, np.nan, blocks.mean(axis=(1, 3)) / full).ravel() / len(shots)
    return shots[0].setting.exposure_time_us, grey


MOST_LOOKS = 33
FIRST_LOOKS = 9
"""Evenly spaced, whatever they show."""
BEND_DB = 0.1
"""If the middle of an interval lies farther than this from the line between its ends, its halves are looked at."""
FLOAT_STEPS = 1024
"""A gain without increments is looked at in steps of this part of its range."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class GainLooks:
    """Two passes over the same gains, each in rising order of the gain; the second was taken in reverse.

    Light that changes steadily cancels in the mean of the two. The camera takes multiples of `step`.
    """

    there: tuple[GainLook, ...]
    back: tuple[GainLook, ...]
    step: float


def capture_gain(camera: StaticCamera, progress: Progress = lambda done, total: None) -> GainLooks:
    """Look at a static scene in steady light at enough gains to know all of them.

    The camera is driven in the gain's own numbers: the bounds and increment of its gain are those of the node.
    `progress` is called with the looks taken, and about how many there will be. Raises CameraError when it fails.
    """
    limits = camera.limits
    low, high = limits.min_gain_db, limits.max_gain_db
    step = limits.gain_step_db or (high - low) / FLOAT_STEPS
    looks: dict[float, GainLook] = {}

    def see(number: float, time_us: float) -> None:
        looks[number] = look_near(camera, number, time_us)
        progress(len(looks), 2 * max(len(looks), FIRST_LOOKS))

    see(low, FIRST_TIME_US)
    see(high, looks[low].time_us)
    spans = deque([(low, high)])
    while spans and len(looks) < MOST_LOOKS:
        below, above = spans.popleft()
        middle = low + round(((below + above) / 2.0 - low) / step) * step
        if not below < middle < above:
            continue
        see(middle, looks[below].time_us)
        if len(looks) + len(spans) < FIRST_LOOKS or _bends(looks[low], looks[below], looks[middle], looks[above]):
            spans += [(below, middle), (middle, above)]
    order = list(looks)
    back: dict[float, GainLook] = {}
    for number in reversed(order):
        back[number] = look(camera, number, looks[number].time_us)
        progress(len(looks) + len(back), 2 * len(looks))
    there, again = (tuple(way[number] for number in sorted(way)) for way in (looks, back))
    return GainLooks(there, again, step)


def _bends(reference: GainLook, below: GainLook, middle: GainLook, above: GainLook) -> bool:
    low_db, here_db, high_db = (seen.gain_db(reference) for seen in (below, middle, above))
    part = (middle.number - below.number) / (above.number - below.number)
    return math.isfinite(here_db) and abs(here_db - low_db - part * (high_db - low_db)) > BEND_DB


NO_EFFECT_DB = 0.5
CHANGED_DB, DOUBTED_DB = 0.5, 0.1
"""Difference between the two looks at one gain from which the light counts as changed: refused, warned of."""
UNEVEN = 0.1
"""If the patches of a scene disagree by more about one gain, the scene moved."""
FALL_DB = 0.1
SIGMAS = 2.0
LEAST_ERROR_DB = 0.02
"""Cameras round exposure times without saying so."""


@dataclass(frozen=True, slots=True, eq=False)
class GainCurve:
    """Gains in dB above the lowest."""

    settings: Array  # the gains in the camera's own numbers, rising, shape (n,)
    gains_db: Array  # their values in dB, not falling, the first 0; empty if the looks give none
    # how far any gain within the range may be from the truth: 0.02 dB, the spread of the two passes (two standard
    # errors), and what straight lines between the settings miss
    error_db: float
    findings: tuple[Finding, ...]  # reasons not to believe it


def solve_gain(looks: GainLooks) -> GainCurve:
    """The gain in dB of each setting that was looked at, and the reasons against believing it."""
    settings = np.array([seen.number for seen in looks.there])
    reference = looks.there[0]
    there, back = (np.array([seen.gain_db(reference) for seen in way]) for way in (looks.there, looks.back))
    unseen = ~np.isfinite(there + back)
    if unseen.any():
        return _refused(settings, "clipped", _unseen(settings[unseen], len(settings)))
    apart_db = np.abs(back - there)
    unevenness = max(seen.unevenness(reference) for way in (looks.there, looks.back) for seen in way)
    raw_db = (there + back) / 2.0
    raw_db -= raw_db[0]
    findings = tuple(_judge(settings, raw_db, float(apart_db.max()), unevenness))
    gains_db = np.maximum.accumulate(raw_db)
    spread_db = SIGMAS * float(np.sqrt(np.mean(apart_db**2))) / 2.0
    levelled_db = float((gains_db - raw_db).max())
    missed_db = _missed_db(settings, gains_db, looks.step)
    return GainCurve(settings, gains_db, LEAST_ERROR_DB + spread_db + levelled_db + missed_db, findings)


def _missed_db(settings: Array, gains_db: Array, step: float) -> float:
    """What straight lines may miss between settings that are more than a step apart.

    A line misses no more than longer ones, without the setting at either of its ends, miss there.
    """
    if len(settings) < 3:
        return 0.0
    part = (settings[1:-1] - settings[:-2]) / (settings[2:] - settings[:-2])
    bend_db = np.abs(gains_db[1:-1] - gains_db[:-2] - part * (gains_db[2:] - gains_db[:-2]))
    at_ends = np.concatenate([bend_db[:1], bend_db, bend_db[-1:]])
    missed_db = np.minimum(at_ends[:-1], at_ends[1:])
    return float(missed_db[np.diff(settings) > 1.5 * step].max(initial=0.0))


def _judge(settings: Array, raw_db: Array, apart_db: float, unevenness: float) -> Iterator[Finding]:
    if unevenness > UNEVEN:
        yield Finding(
            "refused", "moving_scene",
            f"parts of the picture disagree by {unevenness:.0%} about one gain: put the camera on a tripod and keep "
            "out of the picture",
        )  # fmt: skip
    elif apart_db > DOUBTED_DB:
        yield Finding(
            "refused" if apart_db > CHANGED_DB else "warned", "light_changed",
            f"one gain measured twice differs by {apart_db:.2f} dB: use light that neither changes nor flickers, and "
            "let lamps warm up",
        )  # fmt: skip
    if np.abs(raw_db).max() < NO_EFFECT_DB:
        yield Finding(
            "refused", "no_effect",
            f"the gain has no effect: {np.abs(raw_db).max():.2f} dB from {settings[0]:g} to {settings[-1]:g}; see "
            "whether another feature disables it",
        )  # fmt: skip
        return
    falls_db = np.maximum.accumulate(raw_db) - raw_db
    worst = int(falls_db.argmax())
    if falls_db[worst] > FALL_DB + apart_db:
        yield Finding(
            "refused", "not_rising",
            f"the image gets darker by {falls_db[worst]:.1f} dB as the gain rises to {settings[worst]:g}: such a gain "
            "cannot be driven",
        )  # fmt: skip


def _unseen(settings: Array, count: int) -> str:
    return (
        f"at {len(settings)} of {count} gains, such as {settings[0]:g}, nearly all of the picture is black or "
        "saturated at any exposure time that the camera takes: choose a scene of middle grey, and "
        "brighter or dimmer light"
    )


def _refused(settings: Array, reason: str, text: str) -> GainCurve:
    return GainCurve(settings, np.empty(0), float("nan"), (Finding("refused", reason, text),))
