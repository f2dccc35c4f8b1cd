"""The content of calibration files of a made-up pair."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import yaml

from calibration.geometry.opencv import read_camera, ros_yaml
from calibration.geometry.slam import read_camchain
from imaging.frames import SIDES, Side
from imaging.geometry import CameraGeometry

LENSES = {"radtan": [-0.2, 0.05, 0.001, 0.0005], "equidistant": [0.01, 0.002, -0.001, 0.0005], "none": []}


def camchain(model: str = "radtan", turn: tuple[float, ...] = (0.01, -0.02, 0.005)) -> dict[str, Any]:
    """As Kalibr writes it: the right camera 80 mm to the right, and turned a little (rad)."""
    rotation = cv2.Rodrigues(np.array(turn))[0]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ np.array([0.08, 0.001, -0.002])
    document: dict[str, Any] = {
        name: {
            "cam_overlaps": [],
            "camera_model": "pinhole",
            "distortion_coeffs": list(LENSES[model]),
            "distortion_model": model,
            "intrinsics": [860.0 + place, 861.0, 359.5, 269.5],
            "resolution": [720, 540],
            "rostopic": f"/{name}/image_raw",
        }
        for place, name in enumerate(("cam0", "cam1"))
    }
    document["cam1"]["T_cn_cnm1"] = pose.tolist()
    return document


def of_chain(content: dict[str, Any], side: Side = "left") -> CameraGeometry:
    """One side of a camchain of two cameras."""
    return read_camchain(content).pair("cam0", "cam1")[SIDES.index(side)]


def of_ros(content: dict[str, Any]) -> CameraGeometry:
    """The camera of a ROS file."""
    (geometry,) = read_camera(content).lenses.values()
    return geometry


def ros(side: Side) -> dict[str, Any]:
    """As ROS keeps the same camera."""
    document: dict[str, Any] = yaml.safe_load(ros_yaml(of_chain(camchain(), side), side))
    return document


def small_ros(side: Side, width: int, height: int) -> dict[str, Any]:
    """Of cameras with frames of another size, and 80 mm apart."""
    document = ros(side) | {"image_width": width, "image_height": height}
    x, y = width / 2, height / 2
    document["camera_matrix"]["data"] = [width, 0, x, 0, width, y, 0, 0, 1]
    fourth = -0.08 * width if side == "right" else 0.0
    document["projection_matrix"]["data"] = [width, 0, x, fourth, 0, width, y, 0, 0, 0, 1, 0]
    return document
