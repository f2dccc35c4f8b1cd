"""What a camera is set to before its first frame."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from documents.text import quoted
from imaging.gain_scale import GainScale
from imaging.pixels import PixelFormat

FeatureValue = bool | int | float | str

EXECUTE = "execute"
"""The value of a command."""
LONGEST_TEXT = 256

_NAME = r"[A-Za-z_]\w*"
_KEY = re.compile(rf"(?:{_NAME}\[[^\[\]\s]+\]\.)*{_NAME}")
_SELECTION = re.compile(rf"({_NAME})\[([^\[\]\s]+)\]\.")


@dataclass(frozen=True, slots=True)
class FeatureSetting:
    """What one feature is set to, for the given entries of its selectors (name and entry, outermost first)."""

    name: str
    value: FeatureValue
    selectors: tuple[tuple[str, str], ...] = ()

    @property
    def key(self) -> str:
        """As it is written: `LineSelector[Line2].LineInverter`."""
        return "".join(f"{selector}[{entry}]." for selector, entry in self.selectors) + self.name

    def entry(self, selector: str) -> str | None:
        """The entry of a selector that it is for; None if it does not name that selector."""
        return dict(self.selectors).get(selector)


def parse_features(content: object) -> tuple[FeatureSetting, ...]:
    """The settings in a YAML list; raises ValueError, in one sentence, for anything else."""
    if not isinstance(content, list):
        raise ValueError("is not a list: begin each line with a dash, `- Name: value`, as the order counts")
    return tuple(_parsed(f"item {number}", item) for number, item in enumerate(content, 1))


def as_list(features: Iterable[FeatureSetting]) -> list[dict[str, FeatureValue]]:
    """The list that `parse_features` reads."""
    return [{feature.key: feature.value} for feature in features]


def _parsed(where: str, item: object) -> FeatureSetting:
    if not isinstance(item, dict) or len(item) != 1:
        raise ValueError(f"{where} is not one `- Name: value`: write each feature on a line of its own, with a dash")
    ((key, value),) = item.items()
    if not isinstance(key, str) or len(key) > LONGEST_TEXT or not _KEY.fullmatch(key):
        raise ValueError(f"{where}: {quoted(str(key))} is not a feature: write `Name`, or `Selector[Entry].Name`")
    if (words := misfit(value)) is not None:
        raise ValueError(f"{where}: {key} is set to {quoted(value)}: {words}")
    name = key.rpartition(".")[2]
    return FeatureSetting(name, value, tuple(_SELECTION.findall(key)))


def misfit(value: object) -> str | None:
    """What to give instead of a value that no feature holds, or that cannot be written in a list."""
    if isinstance(value, str):
        fits = len(value) <= LONGEST_TEXT and value.isprintable()
        return None if fits else f"give at most {LONGEST_TEXT} printable characters"
    if not isinstance(value, bool | int | float):
        return "give a number, true, false, or text in quotes"
    return None if abs(value) < 1 << 64 else "give a number of at most 64 bits"  # false for NaN, too


TriggerMode = Literal["external", "free_run", "software", "ptp"]


@dataclass(frozen=True, slots=True)
class TriggerSetup:
    """What starts an exposure."""

    # "external": every rising edge on `line`; "free_run": the camera's own clock at `rate_hz`; "software": each
    # `Camera.trigger`; "ptp": when its clock, synchronised by PTP, shows the time of a `Camera.schedule`
    mode: TriggerMode
    line: str = "Line0"  # the camera's input line, by the name of its TriggerSource entry
    # frame rate (Hz); written to the camera only in a free run, otherwise that of its triggers. None, in a free run: as
    # fast as exposure and readout allow, so that exposures may have any length
    rate_hz: float | None = 60.0
    longest_exposure_us: float = 0.0  # the longest exposure time that will be asked for
    # in a free run, the output line that the camera holds active while it exposes, to trigger another camera; None:
    # none
    output_line: str | None = None


@dataclass(frozen=True, slots=True)
class ActionKeys:
    """What an action command and a camera must have in common: both keys, and a bit of the mask."""

    device: int
    group: int
    mask: int


ACTION_KEYS = ActionKeys(0xAE, 1, 1)
"""Any will do: commands are sent to each camera alone."""


@dataclass(frozen=True, slots=True)
class LinkShare:
    """The link to the host that so many cameras share, and its speed; None: that of the host's network interface."""

    cameras: int
    mbps: float | None = None


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """Trigger wiring, image format and transport of one camera; None keeps what the camera has."""

    trigger: TriggerSetup  # what starts an exposure
    pixel_format: PixelFormat | None = None  # its PixelFormat
    binning: int | None = None  # `binning` x `binning` pixels are read as one, over the whole sensor
    # GigE Vision only: size of a stream packet, headers included; None uses the largest that gets through
    packet_size_bytes: int | None = None
    # GigE Vision only: the link that its stream has to share; None: it sends as fast as it can
    link_share: LinkShare | None = None
    features: tuple[FeatureSetting, ...] = ()  # features to set before everything else, in this order
    # what a gain that is not in dB means; None leaves such a gain alone. "own numbers" drives it in the numbers of its
    # node, as if they were dB, so that their meaning can be measured
    gain_scale: GainScale | Literal["own numbers"] | None = None
    # microseconds in a count of an exposure time whose unit the camera does not give; None: there is none such
    exposure_count_us: float | None = None
    # stops by which less light reaches its sensor than those of the other cameras: its gain counts less that, so that
    # with equal settings its frames are as bright as theirs
    offset_stops: float = 0.0
