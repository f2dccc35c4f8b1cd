"""Cameras in this process, a scene that shows what each frame was taken with, and what the driver writes to nodes."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.aravis import AravisCamera
from drivers.aravis.nodes import AravisNodes
from drivers.genicam.nodes import NodeMap, read_feature
from drivers.setup import FeatureValue
from fake_camera.device.device import Device
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.gige.server import GigeServer
from fake_camera.imaging import ImageSettings
from fake_camera.usb3.run import CAMERAS_VARIABLE
from fake_camera.usb3.usbip.server import Usb3Server
from imaging.errors import NodeError
from imaging.exposure import ExposureSetting, linear_gain
from imaging.frames import Frame
from tests.fakes import loopback_address

PORTS = os.environ.get(CAMERAS_VARIABLE, "").split(":")
TRANSPORT, NAME_SPACE = ("usb3", "U3V") if PORTS != [""] else ("gige", "GEV")
US_PER_GREY = 40.0
PATIENCE_S = 20.0


@contextlib.contextmanager
def served(device: Device, camera: XmlCamera | None = None) -> Iterator[None]:
    """A camera, perhaps with a description, on the wire of this run; on USB, at a free port."""
    if TRANSPORT == "gige":
        server = GigeServer(device, loopback_address(), camera)
        server.start()
        stop = server.close
    else:
        free = next(port for port in map(Path, PORTS) if not port.exists())
        stop = Usb3Server(device, free, xml=camera).close
    try:
        yield
    finally:
        stop()


class GreyCard:
    """A uniform grey proportional to exposure: frames show what they were actually taken with."""

    sensor_width, sensor_height = 64, 48

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> NDArray[np.uint8]:
        grey = (settings.exposure_time_us / US_PER_GREY * linear_gain(settings.gain_db) / 255) ** settings.gamma * 255
        return np.full((settings.height, settings.width), min(round(grey), 255), np.uint8)

    def lux(self, time_s: float) -> float:
        return 1.0


def frames_until(camera: AravisCamera, grey: float) -> list[Frame]:
    """Frames up to three of this grey level in a row."""
    frames: list[Frame] = []
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        frame = camera.next_frame(0.2)
        if isinstance(frame, Frame):
            frames.append(frame)
            if len(frames) >= 3 and all(abs(late.pixels.mean() - grey) <= 1.5 for late in frames[-3:]):
                return frames
    raise AssertionError(f"no frames of grey level {grey:g}, but {[frame.pixels.mean() for frame in frames]}")


def grey_of(setting: ExposureSetting) -> float:
    return setting.exposure_time_us / US_PER_GREY * linear_gain(setting.gain_db)


SELECTORS = {
    *("TriggerSelector", "GainSelector", "ChunkSelector", "LineSelector", "ActionSelector"),
    *("TimestampLatch", "GevTimestampControlLatch", "PtpDataSetLatch"),
}
"""May be features all the same: the driver sets a selector whenever it needs it, and may latch at any time."""


def names_written(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Names of the nodes that are written from now on, as if none held its value already."""
    names: set[str] = set()

    def read_unless_writable(nodes: NodeMap, name: str) -> FeatureValue:
        if nodes.writable(name):
            raise NodeError(name)
        return read_feature(nodes, name)

    monkeypatch.setattr("drivers.genicam.nodes.read_feature", read_unless_writable)

    def noting(method: str) -> None:
        original = getattr(AravisNodes, method)

        def note(nodes: AravisNodes, name: str, *value: object) -> None:
            names.add(name)
            original(nodes, name, *value)

        monkeypatch.setattr(AravisNodes, method, note)

    for method in ("write", "execute"):
        noting(method)
    return names
