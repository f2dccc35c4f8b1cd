"""What can go wrong with a camera, one class for each way a caller may want to react."""


class AutoexposeError(Exception):
    """Root of the errors this project raises on purpose: one clear sentence for the user, never a traceback."""


class ConfigurationError(AutoexposeError, ValueError):
    """What the user asked for cannot be: mend the configuration."""


class CameraError(AutoexposeError):
    """A camera did not do what it should; the message names its serial."""


class CameraNotFoundError(CameraError):
    """No camera of that serial answers: try again later."""


class CameraBusyError(CameraError):
    """Another program holds the camera's control privilege: try again later."""


class CameraLostError(CameraError):
    """The camera stopped answering: tear it down and build it anew."""


class UnsupportedCameraError(CameraError):
    """The camera lacks what is needed, or offers it in a way that cannot be driven: trying again does not help."""


class NodeError(CameraError):
    """A node refused a value, or holds another one than was written."""
