"""ORB-SLAM3 as a `StereoOdometry`, where its Python package is installed (docs/odometry.md)."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.odometry.stereo import StereoCamera, Tracked
from evaluation.odometry.tracking import EVERY
from evaluation.scenes.scenarios import RATE_HZ

PACKAGE = "orbslam3-python"

_SETTINGS = """\
%YAML:1.0
File.version: "1.0"
Camera.type: "Rectified"
Camera1.fx: {camera.focal_px}
Camera1.fy: {camera.focal_px}
Camera1.cx: {camera.centre_px[0]}
Camera1.cy: {camera.centre_px[1]}
Camera.width: {width}
Camera.height: {height}
Camera.fps: {fps}
Camera.RGB: 1
Stereo.b: {camera.baseline_m}
Stereo.ThDepth: 60.0
ORBextractor.nFeatures: 1200
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -1.8
Viewer.ViewpointF: 500.0
"""
"""Nothing is drawn, but the viewer's settings must be present."""


def installed() -> bool:
    """Whether the package can be found."""
    return find_spec("orbslam3") is not None


class OrbSlam3:
    """One run of ORB-SLAM3. It maps in its own threads, so results depend on the load of the machine.

    Parameters
    ----------
    camera
        The stereo camera.
    vocabulary
        A file by `write_vocabulary`, or ORB-SLAM3's own.
    folder
        Where its settings are written.
    interval_s
        Between pairs.
    """

    def __init__(
        self, camera: StereoCamera, vocabulary: Path, folder: Path, interval_s: float = EVERY / RATE_HZ
    ) -> None:
        orbslam3: Any = import_module("orbslam3")
        width, height = (round(2 * middle + 1) for middle in camera.centre_px)
        settings = folder / "orb_slam3.yaml"
        text = _SETTINGS.format(camera=camera, width=width, height=height, fps=round(1 / interval_s))
        settings.write_text(text, encoding="ascii")
        self._system: Any = orbslam3.System(str(vocabulary), str(settings), orbslam3.Sensor.STEREO)
        self._tracking: Any = orbslam3.TrackingState.OK
        self._system.initialize()
        self._interval_s = interval_s
        self._pairs = 0
        self._pose, self._start = np.eye(4), np.eye(4)
        self._lost = False

    def track(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Tracked:
        """The pose at the next pair; a lost pair has that of the pair before."""
        self._system.process_image_stereo(left, right, self._pairs * self._interval_s)
        self._pairs += 1
        was_lost, self._lost = self._lost, self._system.get_tracking_state() != self._tracking
        if not self._lost:
            found = np.linalg.inv(np.asarray(self._system.get_frame_pose(), np.float64))
            if was_lost and np.array_equal(found, np.eye(4)):  # it has started another map
                self._start = self._pose
            self._pose = self._start @ found
        return Tracked(self._pose, self._lost)

    def close(self) -> None:
        """End its threads."""
        self._system.shutdown()
