"""Fixtures for pytest: `gige_camera`, `usb3_camera` and `camera_rig`, running from the start of a test to its end.

What kind of camera is said by a marker, with the arguments of the functions of the same names::

    @pytest.mark.camera_twin(description=Path("blackfly.xml"), light={"light": [{"at_s": 0, "lux": 50}]})
    def test_my_driver(gige_camera): ...


    @pytest.mark.camera_twin(n=4)
    def test_my_robot(camera_rig): ...
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from fake_camera.bench import cameras
from fake_camera.bench.cameras import RunningCamera
from fake_camera.bench.nursery import forked

MARKER = "camera_twin"


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker."""
    config.addinivalue_line("markers", f"{MARKER}(**arguments): what the fake cameras of this test are like")


def _arguments(request: pytest.FixtureRequest) -> dict[str, Any]:
    marker = request.node.get_closest_marker(MARKER)
    return {"start": forked} | ({} if marker is None else marker.kwargs)


@pytest.fixture
def gige_camera(request: pytest.FixtureRequest) -> Iterator[RunningCamera]:
    """A GigE Vision camera on the loopback interface."""
    with cameras.gige_camera(**_arguments(request)) as camera:
        yield camera


@pytest.fixture
def usb3_camera(request: pytest.FixtureRequest) -> Iterator[RunningCamera]:
    """A USB3 Vision camera, for programs with its `environment()`."""
    with cameras.usb3_camera(**_arguments(request)) as camera:
        yield camera


@pytest.fixture
def camera_rig(request: pytest.FixtureRequest) -> Iterator[dict[str, RunningCamera]]:
    """Cameras on one trigger wire by their places: without a marker, two GigE Vision cameras, `left` and `right`."""
    with cameras.camera_rig(**_arguments(request)) as rig:
        yield rig
