"""What a policy of another package is made of: derive from `ExposurePolicy`, and name the class as an entry point.

In the `pyproject.toml` of that package::

    [project.entry-points."autoexpose.policies"]
    brightest = "brightest_policy:Brightest"
"""

from autoexpose_daemon.control.policy import ExposurePolicy, Look, Observation, PastStep, Target
from autoexpose_daemon.control.setup import ControlSetup

__all__ = ["ControlSetup", "ExposurePolicy", "Look", "Observation", "PastStep", "Target"]
