"""The policies that other packages bring: found by their entry points, tried, and made known to control."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import numpy as np

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.ids import GROUP, OWN, POLICY_IDS, REMOVED, UNFIT
from autoexpose_daemon.control.policy import ExposurePolicy
from autoexpose_daemon.control.setup import ControlSetup
from documents.text import readable
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.geometry import SIDES
from imaging.response import ResponseFunction

_NAME = re.compile("[a-z0-9][a-z0-9_-]{0,39}")
_SENTENCE = 300
_FRAME_NS = 16_666_667
_RAMP = np.tile(np.linspace(20.0, 200.0, 180), (136, 1)).astype(np.uint8)
_PICTURES = (
    ("a picture", _RAMP),
    ("a darker picture", _RAMP // 2),
    ("a black picture", np.zeros_like(_RAMP)),
    ("a white picture", np.full_like(_RAMP, 255)),
    ("a picture after a white one", _RAMP),
)
"""What each policy must be able to decide on, whatever it makes of it."""


@cache
def register_policies() -> tuple[str, ...]:
    """Make the policies of other packages known to control, in this process; what cannot be used, in sentences.

    Nothing goes wrong until one of those is asked for: then `check_policy_id` says its sentence.
    """
    points = entry_points(group=GROUP)
    said = [sentence for point in points if (sentence := _entered(point, points)) is not None]
    return tuple(dict.fromkeys(said))


def _entered(point: EntryPoint, points: Iterable[EntryPoint]) -> str | None:
    """Enter a policy into the table of control; returns what is wrong with it."""
    name = point.name
    try:
        _check_name(name, [_package(each) for each in points if each.name == name])
        OWN[name] = _loaded(point)
        _try_out(name)
    except Exception as error:  # of code that is not ours
        OWN.pop(name, None)
        what = str(error) if isinstance(error, ConfigurationError) else f"{type(error).__name__}: {error}"
        sentence = readable(f"policy {name} of {_package(point)} cannot be used: {what}")[:_SENTENCE]
        UNFIT.setdefault(name, sentence)
        return sentence
    return None


def _package(point: EntryPoint) -> str:
    return "a package without a name" if point.dist is None else point.dist.name


def _check_name(name: str, packages: list[str]) -> None:
    if not _NAME.fullmatch(name):
        raise ConfigurationError("a name has small letters, digits, - and _, 40 at most")
    if name in POLICY_IDS or name in REMOVED["policy"] or name == "all":
        raise ConfigurationError("autoexpose itself uses that name: give it another")
    if len(packages) > 1:
        raise ConfigurationError(f"the name is used by {' and '.join(sorted(packages))}: remove one of them")


def _loaded(point: EntryPoint) -> type[ExposurePolicy]:
    kind: Any = point.load()
    if not (isinstance(kind, type) and issubclass(kind, ExposurePolicy)):
        raise ConfigurationError(f"{point.value} does not derive from autoexpose_daemon.own_policy.ExposurePolicy")
    if inspect.isabstract(kind):
        raise ConfigurationError(f"{point.value} lacks {' and '.join(sorted(kind.__abstractmethods__))}")
    return kind


def _try_out(name: str) -> None:
    """Have it decide on a few pictures, and check that its state is all that it remembers.

    Raises ConfigurationError.
    """
    response, limits = ResponseFunction.linear(), ExposureLimits(20.0, 7500.0, 0.0, 30.0)
    setup = ControlSetup(name, dict.fromkeys(SIDES, response), limits, ExposureSetting(2000.0, 3.0))
    loop = ControlLoop(setup)
    for number, (what, pixels) in enumerate(_PICTURES):
        time_ns = number * _FRAME_NS
        frame = Frame(pixels, 8, number, time_ns, time_ns, time_ns, setup.start)
        pair = FrameSet(number, dict.fromkeys(SIDES, frame))
        try:
            restored = ControlLoop(setup)
            restored.restore(loop.state())
            decision = loop.step(pair)
        except Exception as error:
            raise ConfigurationError(f"on {what} it raises {type(error).__name__}: {error}") from error
        if not math.isfinite(decision.level):
            raise ConfigurationError(f"on {what} its target is a level of {decision.level}")
        if restored.step(pair) != decision:
            raise ConfigurationError(
                "it remembers something that its class does not annotate: a replay would decide otherwise"
            )
