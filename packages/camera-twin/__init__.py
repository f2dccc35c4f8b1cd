"""Machine-vision cameras in software that speak GigE Vision and USB3 Vision and obey triggers, for tests.

This is the API, versioned as semver.org has it; what else there is may change.
"""

from fake_camera.bench import (
    Fault,
    NotStartedError,
    RunningCamera,
    ShimError,
    Side,
    camera_rig,
    client_environment,
    gige_camera,
    ptp_master,
    usb3_camera,
)

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
