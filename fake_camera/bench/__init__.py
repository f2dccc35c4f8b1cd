"""Fake cameras for the tests and scripts of others: this is the API, the rest may change."""

from fake_camera.bench.cameras import RunningCamera, camera_rig, gige_camera, ptp_master, usb3_camera
from fake_camera.bench.process import NotStartedError
from fake_camera.device.faults import Fault
from fake_camera.places import Side
from fake_camera.usb3.run import ShimError, client_environment

__all__ = [
    "Fault",
    "NotStartedError",
    "RunningCamera",
    "ShimError",
    "Side",
    "camera_rig",
    "client_environment",
    "gige_camera",
    "ptp_master",
    "usb3_camera",
]
