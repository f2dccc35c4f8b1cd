"""A camera that we did not write: Aravis' own fake, with an exposure time, a raw gain, and little else."""

from __future__ import annotations

import contextlib
from itertools import pairwise

import pytest

from drivers.aravis import open_camera
from drivers.camera import IncompleteFrame
from drivers.errors import NodeError
from drivers.exposure import ExposureSetting
from drivers.frames import Frame
from drivers.setup import CameraSetup, TriggerSetup
from tests.fakes import foreign_camera

FREE_RUN = CameraSetup(TriggerSetup("free_run", rate_hz=60.0), pixel_format="Mono8")

pytestmark = pytest.mark.realtime


def test_it_runs_freely_on_exposure_time_alone() -> None:
    with foreign_camera() as serial, contextlib.closing(open_camera(serial, FREE_RUN)) as camera:
        lacks = " ".join(camera.description.lacks)
        assert "gain has no dB scale: left at its present value" in lacks
        assert "no chunk data" in lacks
        assert "no time stamp latch" in lacks
        assert camera.limits.min_gain_db == camera.limits.max_gain_db == 0.0
        camera.start()
        outcomes = [camera.next_frame(0.5) for _ in range(120)]
        assert sum(isinstance(frame, Frame) for frame in outcomes) >= 0.9 * len(outcomes)

        taken = camera.write(ExposureSetting(4321.0, 0.0))
        assert taken == ExposureSetting(4321.0, 0.0)
        later = [camera.next_frame(0.5) for _ in range(30)][-1]
        assert isinstance(later, Frame)
        assert later.setting == taken
        with pytest.raises(NodeError, match="no gain in dB"):
            camera.write(ExposureSetting(4321.0, 6.0))


def test_frames_with_holes_are_told_apart() -> None:
    """It sends no packet again; of its 190 packets a frame, 5 in a thousand get lost."""
    with foreign_camera("-r", "5") as serial, contextlib.closing(open_camera(serial, FREE_RUN)) as camera:
        camera.start()
        outcomes = [outcome for _ in range(60) if (outcome := camera.next_frame(0.5)) is not None]
        incomplete = [outcome for outcome in outcomes if isinstance(outcome, IncompleteFrame)]
        assert incomplete
        assert len(incomplete) < len(outcomes)
        assert all(earlier.frame_id < later.frame_id for earlier, later in pairwise(outcomes))
        assert all(frame.host_time_ns is not None for frame in incomplete)
