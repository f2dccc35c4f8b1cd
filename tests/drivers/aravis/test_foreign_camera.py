"""A camera that we did not write: Aravis' own fake, with an exposure time, a raw gain, and little else."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from itertools import pairwise

import pytest

from drivers.aravis import AravisCamera, open_camera
from drivers.camera import IncompleteFrame
from drivers.setup import CameraSetup, TriggerSetup
from imaging.errors import NodeError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.pixels import PixelFormat
from tests.fakes import foreign_camera
from tests.meanwhile import wait_until

FREE_RUN = CameraSetup(TriggerSetup("free_run", rate_hz=60.0), pixel_format=PixelFormat.MONO8)

pytestmark = [pytest.mark.wire, pytest.mark.needs("arv-fake-gv-camera-0.8", "arv-tool-0.8")]


Outcome = Frame | IncompleteFrame


def outcomes_until(camera: AravisCamera, enough: Callable[[list[Outcome]], bool]) -> list[Outcome]:
    """Frames, complete or not, up to the awaited one."""
    outcomes: list[Outcome] = []

    def come() -> bool:
        if (outcome := camera.next_frame(0.5)) is not None:
            outcomes.append(outcome)
        return enough(outcomes)

    wait_until(come)
    return outcomes


def test_it_runs_freely_on_exposure_time_alone() -> None:
    with foreign_camera() as serial, contextlib.closing(open_camera(serial, FREE_RUN)) as camera:
        limitations = " ".join(camera.description.limitations)
        assert "not driven, so that dim light stays dark" in limitations
        assert "no chunk data" in limitations
        assert "no time stamp latch" in limitations
        assert camera.limits.min_gain_db == camera.limits.max_gain_db == 0.0
        camera.start()
        outcomes_until(camera, lambda outcomes: sum(isinstance(outcome, Frame) for outcome in outcomes) >= 20)

        taken = camera.write(ExposureSetting(4321.0, 0.0))
        assert taken == ExposureSetting(4321.0, 0.0)
        outcomes_until(camera, lambda them: bool(them) and isinstance(them[-1], Frame) and them[-1].setting == taken)
        with pytest.raises(NodeError, match="no gain known in dB"):
            camera.write(ExposureSetting(4321.0, 6.0))


def test_frames_with_holes_are_recognised() -> None:
    """It never resends; of its 190 packets per frame, 5 in a thousand get lost."""
    with foreign_camera("-r", "5") as serial, contextlib.closing(open_camera(serial, FREE_RUN)) as camera:
        camera.start()
        outcomes = outcomes_until(camera, lambda them: {type(it) for it in them} == {Frame, IncompleteFrame})
        incomplete = [outcome for outcome in outcomes if isinstance(outcome, IncompleteFrame)]
        assert all(earlier.frame_id < later.frame_id for earlier, later in pairwise(outcomes))
        assert all(frame.host_time_ns is None for frame in incomplete)  # its clock cannot be read, and these are late
