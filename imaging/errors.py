"""What can go wrong with a camera, one class for each way a caller may want to react."""


class AutoexposeError(Exception):
    """Root of the errors this project raises on purpose: one clear sentence for the user, never a traceback."""


class ConfigurationError(AutoexposeError, ValueError):
    """The configuration is invalid, or does not fit the cameras: it must be changed."""


class CameraError(AutoexposeError):
    """A camera did not do what it should; the message names its serial."""


class CameraNotFoundError(CameraError):
    """No camera with that serial answers: try again later."""


class CameraBusyError(CameraError):
    """The camera is busy, or another program holds its control privilege: try again later."""


class CameraLostError(CameraError):
    """The camera stopped answering: close it and open it again."""


class UnsupportedCameraError(CameraError):
    """The camera lacks a feature we need, or offers it in a form we cannot use: retrying does not help."""


class NodeError(CameraError):
    """A node refused a value, or holds a different one than was written: what the camera is, not what it does now."""


_PASSING = (CameraNotFoundError, CameraBusyError, CameraLostError)


def stays(error: AutoexposeError) -> bool:
    """Whether trying the same again will fail again, until the camera or its configuration is another one."""
    return not isinstance(error, _PASSING)
