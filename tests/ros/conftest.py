"""Makes the package importable, which elsewhere colcon installs."""

from __future__ import annotations

import sys

from tests import REPOSITORY

sys.path.insert(0, str(REPOSITORY / "ros/autoexpose_ros"))
