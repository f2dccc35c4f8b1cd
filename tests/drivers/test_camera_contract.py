"""The contract of cameras, on stand-ins for real ones; aravis/test_camera_contract.py runs it over the wire."""

from __future__ import annotations

import time

import pytest

from drivers.camera import Camera
from tests.autoexpose_daemon.scripted import Session, TriggeredCamera
from tests.drivers.camera_contract import CameraContract
from tests.soak.camera import Device
from tests.soak.clock import MS, Clock


class VirtualBench:
    def __init__(self) -> None:
        self.device = Device("left", Clock(), seed=1)
        self.camera: Camera = self.device.open()
        self._pulses = 0

    def pulse(self) -> None:
        self._pulses += 1
        self.device.pulse(self._pulses, self.device.clock.now_ns)
        self.device.clock.now_ns += 50 * MS

    def vanish(self) -> None:
        self.device.vanish()


class ScriptedBench:
    def __init__(self) -> None:
        self.device = TriggeredCamera("L")
        self.camera: Camera = Session(self.device)

    def pulse(self) -> None:
        self.device.pulse(time.monotonic_ns())

    def vanish(self) -> None:
        self.device.lost = True


class TestVirtualCamera(CameraContract):
    @pytest.fixture
    def bench(self) -> VirtualBench:
        return VirtualBench()


class TestScriptedCamera(CameraContract):
    @pytest.fixture
    def bench(self) -> ScriptedBench:
        return ScriptedBench()
