"""Drives out of recordings by `autoexpose record --bracket`."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlSetup
from autoexpose_daemon.control.parameters import Bracketing
from autoexpose_daemon.recording.file import LoopState, RecordingError, Setup, Step
from autoexpose_daemon.recording.read import Recording
from evaluation.rejudge.drive import Drive, watched
from imaging.frames import Side, StereoPair
from imaging.geometry import CameraGeometry


def read_recording(path: Path) -> Drive:
    """Read a recording for the first time.

    Raises
    ------
    AutoexposeError
        In one sentence, when it cannot be read, or was not recorded in brackets.
    """
    setup = _setup(path)
    bracket = setup.parameters.bracket
    if bracket is None:
        raise RecordingError(f"{path}: was not recorded in brackets: record the drive with `record --bracket`")
    geometries: dict[Side, CameraGeometry] = {}

    def seen() -> Iterator[tuple[StereoPair, Decision, float]]:
        for step in _steps(path, bracket):
            geometries.update(step.calibrations)
            yield step.pair, step.decision, step.stamp_ns * 1e-9

    return watched(str(path), setup, seen(), partial(_pairs, path, bracket), geometries)


def _setup(path: Path) -> ControlSetup:
    """The first setup of a recording."""
    for item in Recording(path):
        if isinstance(item, Setup):
            return item.control
    raise RecordingError(f"{path}: is damaged: it does not say how it was made")


def _pairs(path: Path, bracket: Bracketing) -> Iterator[StereoPair]:
    return (step.pair for step in _steps(path, bracket))


def _steps(path: Path, bracket: Bracketing) -> Iterator[Step]:
    """Those with complete pairs."""
    for item in Recording(path):
        match item:
            case Step() if len(item.pair.frames) == item.cameras:
                yield item
            case Setup() if item.control.parameters.bracket != bracket:
                raise RecordingError(f"{path}: its brackets change on the way: record the drive in one piece")
            case Setup() | LoopState() | Step():
                pass
