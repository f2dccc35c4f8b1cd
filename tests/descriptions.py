"""Real descriptions, each worn by a fake camera and driven by the daemon through stock Aravis; prints a table.

``python -m tests.descriptions [NAME...]`` takes those of `tests.data` that are for GigE Vision; in an environment with
a USB bus of fake cameras (`tests.fakes.usb3_environment`) those for USB3 Vision. It ends with 1 if one of them is
neither driven, its gain too or with a calibration of it proposed, nor refused for what stays.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.setup import openers
from drivers.aravis import AravisCamera
from drivers.camera import Camera
from fake_camera.device.device import Device
from fake_camera.device.line0 import Line0
from fake_camera.genapi.description import Description
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.gige.server import GigeServer
from fake_camera.imaging import ImageSettings
from fake_camera.usb3.run import CAMERAS_VARIABLE
from fake_camera.usb3.usbip.server import Usb3Server
from imaging.errors import AutoexposeError, stays
from imaging.exposure import linear_gain
from imaging.frames import Frame
from tests.data import data
from tests.fakes import loopback_address, unique
from tests.meanwhile import meanwhile

RATE_HZ = 50.0
LONGEST_US = 4000.0
TARGET_GREY, OFF_GREY = 51.0, 5.0
"""What the policy aims at, and how near counts as settled."""
SETTLED_FRAMES = 5
BRIGHT, DIM = 15.0, 160.0
"""Microseconds per grey level: a quarter of the longest exposure is enough, or it needs twice as much by gain."""
NEEDED_DB = 4.0
"""At least this much of it, as frames of the brighter light may still be on their way."""
PATIENCE_S = 20.0


class Card:
    """A uniform grey under a light that can be changed."""

    sensor_width, sensor_height = 128, 96
    us_per_grey = BRIGHT

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> NDArray[np.uint8]:
        grey = settings.exposure_time_us / self.us_per_grey * linear_gain(settings.gain_db)
        return np.full((settings.height, settings.width), min(round(grey), 255), np.uint8)

    def lux(self, time_s: float) -> float:
        return 1.0


@dataclass
class Outcome:
    """What became of one description."""

    name: str
    trigger: str
    nodes: str = "-"
    settled_after: int | None = None
    gain: str = ""
    trouble: str | None = None
    refusal: AutoexposeError | None = None

    @property
    def is_right(self) -> bool:
        """Whether it was driven, or refused for what stays."""
        if self.refusal is not None:
            return stays(self.refusal)
        return self.trouble is None and self.settled_after is not None

    def __str__(self) -> str:
        if self.refusal is not None:
            outcome = f"refused: {self.refusal}"
        else:
            outcome = self.trouble or f"settled after {self.settled_after:2} frames; {self.gain}"
        return f"{self.name:26} {self.trigger:9} {self.nodes:44} {outcome}"


@dataclass
class Watched:
    """A daemon at work on one camera, its frames and what ended it."""

    opener: Callable[[], Camera]
    frames: list[Frame] = field(default_factory=list)
    camera: AravisCamera | None = None
    failure: BaseException | None = None

    def open(self) -> Camera:
        camera = self.opener()
        assert isinstance(camera, AravisCamera)
        self.camera = camera
        return camera

    def see(self, step: ControlStep) -> None:
        self.frames += step.pair.frames.values()

    def settled_after(self, least_gain_db: float = 0.0) -> int | None:
        """How many of the frames from now on come before those at the target, with this much gain; None if none are."""
        begin, deadline_s = len(self.frames), time.monotonic() + PATIENCE_S
        while self.failure is None and time.monotonic() < deadline_s:
            near = [
                abs(float(frame.pixels.mean()) - TARGET_GREY) < OFF_GREY and frame.setting.gain_db >= least_gain_db
                for frame in self.frames[begin:]
            ]
            for start in range(len(near) - SETTLED_FRAMES + 1):
                if all(near[start : start + SETTLED_FRAMES]):
                    return start
            time.sleep(0.02)
        return None


def descriptions() -> Iterator[Path]:
    """The files of all real descriptions."""
    return itertools.chain(*(sorted(data("genicam_xml").glob(pattern)) for pattern in ("*.xml", "more/*.xml")))


def judged(path: Path, description: Description) -> Outcome:
    """Put the description on a camera on the wire of this process, and the daemon on that."""
    card = Card()
    device = Device(card, unique("XML")[:15], 0, Line0(time.monotonic_ns(), RATE_HZ))
    with contextlib.ExitStack() as running:
        running.callback(device.close)
        camera = XmlCamera(description, device)
        if socket := os.environ.get(CAMERAS_VARIABLE):
            running.callback(Usb3Server(device, Path(socket), xml=camera).close)
        else:
            server = GigeServer(device, loopback_address(), camera)
            server.start()
            running.callback(server.close)
        return _driven(path.stem, card, str(device.features.get("DeviceSerialNumber")), camera.trigger_line)


def _driven(name: str, card: Card, serial: str, line: str | None) -> Outcome:
    trigger = {"mode": "free_run"} if line is None else {"mode": "external", "line": line}
    config = Config.model_validate(
        {
            "cameras": {"left": {"serial": serial}},
            "trigger": {**trigger, "rate_hz": RATE_HZ},
            "image": {"pixel_format": "Mono8"},
            "exposure": {"min_time_us": 20, "max_time_us": LONGEST_US, "min_gain_db": 0, "max_gain_db": 18},
            "control": {"policy": "neves2009"},
        }
    )
    outcome, watched = Outcome(name, line or "free run"), Watched(openers(config)["left"])
    daemon = Daemon(config, {"left": watched.open}, outlets=[watched.see])

    def run(stop: threading.Event) -> None:
        try:
            daemon.run(stop)
        except BaseException as error:
            watched.failure = error

    with meanwhile(run):
        outcome.settled_after = watched.settled_after()
        if watched.camera is not None and watched.failure is None:
            _judge_gain(outcome, watched, watched.camera, card)
        if watched.failure is None and outcome.trouble is None and daemon.telemetry.cameras.troubles:
            outcome.trouble = "; ".join(daemon.telemetry.cameras.troubles.values())
    if isinstance(watched.failure, AutoexposeError):
        outcome.refusal = watched.failure
    elif watched.failure is not None:
        raise watched.failure
    return outcome


def _judge_gain(outcome: Outcome, watched: Watched, camera: AravisCamera, card: Card) -> None:
    dialect, description = camera.dialect, camera.description
    outcome.nodes = f"{dialect.time.node}, {description.gain_node or 'no gain'}, {watched.frames[-1].setting_source}"
    card.us_per_grey = DIM
    if dialect.gain is None:
        outcome.gain = next(words for words in description.limitations if words.startswith("gain ("))
        if "calibrate gain" not in outcome.gain:
            outcome.trouble = outcome.gain
    elif watched.settled_after(NEEDED_DB) is None:
        outcome.trouble = f"gain does not make up for dim light: it stays at {watched.frames[-1].setting}"
    else:
        outcome.gain = f"gain driven to {watched.frames[-1].setting.gain_db:.1f} dB"


def main(names: list[str]) -> int:
    """Print the table, and return how to exit."""
    logging.disable(logging.WARNING)
    standard = "U3V" if os.environ.get(CAMERAS_VARIABLE) else "GEV"
    wrong = 0
    for path in descriptions():
        description = Description.from_bytes(path.read_bytes(), str(path))
        if description.standard == standard and (not names or path.stem in names):
            outcome = judged(path, description)
            wrong += not outcome.is_right
            print(outcome, flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
