"""Made-up rigs, as other programs write them and as we do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from calibration.geometry.opencv import read_camera, ros_yaml
from calibration.geometry.slam import read_camchain
from imaging.geometry import SIDES, CameraGeometry, Side

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MadeRig:
    """Two lenses (fx, fy, cx, cy), their coefficients, and x_right = rotation x_left + translation_m."""

    k: tuple[list[float], list[float]]
    d: tuple[list[float], list[float]]
    rotation: Array
    translation_m: Array
    size: tuple[int, int] = (720, 540)
    model: str = "radtan"

    @property
    def pose(self) -> Array:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotation, self.translation_m
        return pose

    def matrix(self, side: int) -> Array:
        fx, fy, cx, cy = self.k[side]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def made_rig(
    turn: tuple[float, ...] = (0.01, -0.02, 0.005), baseline_m: float = 0.08, model: str = "radtan"
) -> MadeRig:
    """The right camera to the right, turned a little (rad)."""
    rotation = np.asarray(cv2.Rodrigues(np.array(turn))[0], np.float64)
    d = ([-0.2, 0.05, 0.001, 0.0005], [-0.21, 0.06, -0.001, 0.0002])
    if model == "equidistant":
        d = ([0.01, 0.002, -0.001, 0.0005], [0.012, 0.001, -0.001, 0.0004])
    k = ([861.5, 862.5, 355.5, 266.25], [859.25, 860.0, 362.5, 271.0])
    return MadeRig(k, d, rotation, -rotation @ np.array([baseline_m, 0.001, -0.002]), model=model)


IMU_TO_LEFT = np.array([[0.0, -1.0, 0.0, 0.03], [0.0, 0.0, -1.0, 0.05], [1.0, 0.0, 0.0, -0.01], [0.0, 0.0, 0.0, 1.0]])


def _camera(rig: MadeRig, side: int) -> dict[str, Any]:
    return {
        "camera_model": "pinhole",
        "distortion_coeffs": list(rig.d[side]),
        "distortion_model": rig.model,
        "intrinsics": list(rig.k[side]),
        "resolution": list(rig.size),
        "rostopic": f"/cam{side}/image_raw",
    }


def kalibr(rig: MadeRig, folder: Path) -> Path:
    return _chain(folder, {"cam0": _camera(rig, 0), "cam1": {**_camera(rig, 1), "T_cn_cnm1": rig.pose.tolist()}})


def kalibr_with_imu(rig: MadeRig, folder: Path) -> Path:
    left, right = IMU_TO_LEFT, rig.pose @ IMU_TO_LEFT
    chain = {"cam1": {"T_cam_imu": right.tolist(), **_camera(rig, 1)}, "cam0": {"T_cam_imu": left.tolist()}}
    chain["cam0"] |= {**_camera(rig, 0), "timeshift_cam_imu": 0.001, "cam_overlaps": [1]}
    return _chain(folder, chain)


def open_vins(rig: MadeRig, folder: Path) -> Path:
    left, right = np.linalg.inv(IMU_TO_LEFT), np.linalg.inv(rig.pose @ IMU_TO_LEFT)
    chain = {"cam0": {"T_imu_cam": left.tolist(), **_camera(rig, 0)}, "cam1": {"T_imu_cam": right[:3].tolist()}}
    chain["cam1"] |= _camera(rig, 1)
    return _chain(folder, chain, before="%YAML:1.0 # the type\n\n")


def _chain(folder: Path, chain: Mapping[str, Any], before: str = "") -> Path:
    file = folder / "chain.yaml"
    file.write_text(before + yaml.safe_dump(chain, sort_keys=False))
    return file


def storage(file: Path, values: Mapping[str, Any]) -> Path:
    """A file written by OpenCV itself, in the format of its suffix."""
    written = cv2.FileStorage(str(file), cv2.FileStorage_WRITE)
    for key, value in values.items():
        if isinstance(value, tuple):
            written.startWriteStruct(key, cv2.FileNode_SEQ | cv2.FileNode_FLOW)
            for each in value:
                written.write("", each)
            written.endWriteStruct()
        else:
            written.write(key, value)
    written.release()
    return file


def opencv(suffix: str, names: str = "K1 D1 K2 D2 R T") -> Callable[[MadeRig, Path], Path]:
    def write(rig: MadeRig, folder: Path) -> Path:
        values = (rig.matrix(0), np.array([rig.d[0]]), rig.matrix(1), np.array([rig.d[1]]), rig.rotation)
        content = dict(zip(names.split(), (*values, rig.translation_m.reshape(3, 1)), strict=True))
        if rig.model == "equidistant":
            content["distortion_model"] = "fisheye"
        return storage(folder / f"pair{suffix}", {**content, "image_size": rig.size, "rms": 0.21, "E": np.eye(3)})

    return write


def vins(rig: MadeRig, folder: Path) -> Path:
    for side in (0, 1):
        fx, fy, cx, cy = rig.k[side]
        bent = rig.d[side]
        one: dict[str, Any] = {"model_type": "PINHOLE", "camera_name": "camera"}
        one |= {"image_width": rig.size[0], "image_height": rig.size[1]}
        one["distortion_parameters"] = dict(zip(("k1", "k2", "p1", "p2"), bent, strict=True))
        one["projection_parameters"] = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
        if rig.model == "equidistant":
            one["model_type"] = "KANNALA_BRANDT"
            both = {**dict(zip(("k2", "k3", "k4", "k5"), bent, strict=True)), "mu": fx, "mv": fy, "u0": cx, "v0": cy}
            one["projection_parameters"] = both
            del one["distortion_parameters"]
        (folder / f"cam{side}_pinhole.yaml").write_text("%YAML:1.0\n---\n" + yaml.safe_dump(one))
    bodies = np.linalg.inv(IMU_TO_LEFT), np.linalg.inv(rig.pose @ IMU_TO_LEFT)
    content = {f"body_T_cam{side}": body for side, body in enumerate(bodies)}
    files = {f"cam{side}_calib": f"cam{side}_pinhole.yaml" for side in (0, 1)}
    return storage(folder / "vins.yaml", {"imu": 1, "num_of_cam": 2, "output_path": "~/out/", **files, **content})


def orb_slam(rig: MadeRig, folder: Path) -> Path:
    content: dict[str, Any] = {"File.version": "1.0", "Camera.width": rig.size[0], "Camera.height": rig.size[1]}
    content["Camera.type"] = "KannalaBrandt8" if rig.model == "equidistant" else "PinHole"
    names = ("k1", "k2", "k3", "k4") if rig.model == "equidistant" else ("k1", "k2", "p1", "p2")
    for side in (0, 1):
        numbers = (*rig.k[side], *rig.d[side])
        for key, value in zip(("fx", "fy", "cx", "cy", *names), numbers, strict=True):
            content[f"Camera{side + 1}.{key}"] = value
    lines = [f"{key}: {value!r}" for key, value in content.items()]
    back = np.linalg.inv(rig.pose).ravel().tolist()
    lines.append(f"Stereo.T_c1_c2: !!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: f\n  data: {back}")
    file = folder / "orb.yaml"
    file.write_text("%YAML:1.0\n\n#----\n# Camera\n" + "\n".join(lines) + "\n")
    return file


WRITERS: Mapping[str, Callable[[MadeRig, Path], Path]] = {
    "kalibr": kalibr,
    "kalibr with imu": kalibr_with_imu,
    "open_vins": open_vins,
    "opencv yml": opencv(".yml"),
    "opencv xml": opencv(".xml"),
    "opencv json": opencv(".json"),
    "opencv sample": opencv(".yaml", "M1 D1 M2 D2 R T"),
    "opencv names": opencv(".yaml", "cameraMatrixL distCoeffsL cameraMatrixR distCoeffsR R T"),
    "opencv long names": opencv(
        ".xml", "left_camera_matrix left_dist_coeffs right_camera_matrix right_dist_coeffs rotation_matrix trans"
    ),
    "opencv from 0": opencv(".json", "K0 D0 K_1 D_1 R T"),
    "vins": vins,
    "orb": orb_slam,
}


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


def matrices(geometry: CameraGeometry) -> tuple[Array, Array, Array, Array]:
    """Camera matrix, distortion, rectification and projection."""
    k, r = np.reshape(geometry.camera_matrix, (3, 3)), np.reshape(geometry.rectification, (3, 3))
    return k, np.array(geometry.distortion), r, np.reshape(geometry.projection, (3, 4))


def show(geometry: CameraGeometry, points: Array) -> Array:
    """Pixels of points in the camera's axes, by OpenCV."""
    k, d, *_ = matrices(geometry)
    project = cv2.fisheye.projectPoints if geometry.distortion_model == "equidistant" else cv2.projectPoints
    return np.asarray(project(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), k, d)[0]).reshape(-1, 2)


def small_ros(side: Side, width: int, height: int) -> dict[str, Any]:
    """Of cameras with frames of another size, and 80 mm apart."""
    document = ros(side) | {"image_width": width, "image_height": height}
    x, y = width / 2, height / 2
    document["camera_matrix"]["data"] = [width, 0, x, 0, width, y, 0, 0, 1]
    fourth = -0.08 * width if side == "right" else 0.0
    document["projection_matrix"]["data"] = [width, 0, x, fourth, 0, width, y, 0, 0, 0, 1, 0]
    return document
