"""Machine-vision cameras in software that speak GigE Vision and USB3 Vision and obey triggers, for tests.

This is the API, versioned as semver.org has it; what else there is may change.
"""

from fake_camera.bench import *  # noqa: F403
from fake_camera.bench import __all__ as __all__
