"""Every dialect over the wire: cameras with one description each, opened by stock Aravis and by our driver.

Runs directly over GigE Vision; test_on_usb3.py runs it again in a process with the cameras on its USB bus.
"""

from __future__ import annotations

import contextlib
import gc
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers.aravis import AravisCamera, find_cameras, open_camera, open_nodes, opening
from drivers.genicam.features import advice, set_features
from drivers.setup import CameraSetup, FeatureSetting, TriggerSetup, parse_features
from fake_camera.device.device import Device
from fake_camera.device.line0 import Line0
from fake_camera.genapi.description import Description
from fake_camera.genapi.xml_camera import XmlCamera
from imaging.errors import NodeError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.pixels import PixelFormat
from tests.data import data
from tests.drivers.aravis.grey_card import (
    NAME_SPACE,
    SELECTORS,
    TRANSPORT,
    GreyCard,
    frames_until,
    grey_of,
    names_written,
    served,
)
from tests.fakes import unique
from tests.xml_cameras import COMBINATIONS, REAL, xml_camera

pytestmark = pytest.mark.wire

RATE_HZ = 60.0
REAL_ONES = [pytest.param(name, marks=pytest.mark.data) for name in REAL[TRANSPORT]]
ON_BOTH = {1, 8, 10, 11, 12, 16, 17}
"""Enough per transport: each way to write registers, with and without chunks, seconds, a dB scale."""
WORN = [
    *(
        pytest.param(number, marks=[] if number in ON_BOTH else pytest.mark.gige_only)
        for number in range(1, len(COMBINATIONS))
    ),
    *REAL_ONES,
]


@dataclass(frozen=True)
class Worn:
    """A camera in this process with a given description."""

    serial: str
    description: Description
    device: Device
    camera: XmlCamera

    @property
    def exposure_time(self) -> str:
        return next(name for name in ("ExposureTime", "ExposureTimeAbs") if name in self.description.nodes)

    @property
    def us_per_unit(self) -> float:
        return 1e6 if self.description.nodes[self.exposure_time].text("Unit") == "s" else 1.0

    @property
    def gain_in_db(self) -> bool:
        return "Gain" in self.description.nodes and self.description.nodes["Gain"].text("Unit") == "dB"

    @property
    def tells_by_chunks(self) -> bool:
        wanted = {"ChunkExposureTime", *(("ChunkGain",) if self.gain_in_db else ())}
        return wanted <= self.description.nodes.keys()


def description(worn: int | str) -> Description:
    """One of ours, by number, or a real camera's, by name."""
    if isinstance(worn, int):
        return Description.from_bytes(xml_camera(worn, NAME_SPACE), f"combination {worn}")
    path = data(f"genicam_xml/{worn}.xml")
    return Description.from_bytes(path.read_bytes(), str(path))


@pytest.fixture(scope="module")
def cameras(request: pytest.FixtureRequest) -> Iterator[dict[int | str, Worn]]:
    """Starts all that are needed, so that one search finds them."""
    line0 = Line0(time.monotonic_ns(), RATE_HZ)
    here = [item for item in request.session.items if item.path == request.path and hasattr(item, "callspec")]
    needed = {item.callspec.params.get("worn") for item in here}
    with contextlib.ExitStack() as running, pytest.MonkeyPatch.context() as patch:
        patch.setattr(opening, "FRESH_S", float("inf"))
        worn = {}
        for key in needed - {None}:
            serial = unique("XML")[:15]
            device = Device(GreyCard(), serial, 0, line0)
            running.callback(device.close)
            camera = XmlCamera(description(key), device)
            running.enter_context(served(device, camera))
            worn[key] = Worn(serial, camera.description, device, camera)
        find_cameras()
        yield worn
        gc.collect()  # Aravis says goodbye when it frees a camera, and waits for the answer,


@pytest.fixture
def worn(request: pytest.FixtureRequest, cameras: dict[int | str, Worn]) -> Worn:
    return cameras[request.param]


def set_up(worn: Worn) -> CameraSetup:
    line = worn.camera.trigger_line
    assert line is not None
    return CameraSetup(TriggerSetup("external", line, RATE_HZ), pixel_format=PixelFormat.MONO8)


@pytest.mark.realtime
@pytest.mark.parametrize("worn", WORN, ids=str, indirect=True)
def test_the_driver_exposes_by_it_and_each_frame_says_how(worn: Worn) -> None:
    with contextlib.closing(open_camera(worn.serial, set_up(worn))) as camera:
        limits = camera.limits
        assert limits.min_time_us < limits.max_time_us
        camera.start()
        for setting in (ExposureSetting(2000.0, 0.0), ExposureSetting(8000.0, 0.0), ExposureSetting(1000.0, 0.0)):
            taken = camera.write(setting)
            assert taken.agrees_with(setting)
            frames = frames_until(camera, grey_of(setting))
            assert {frame.setting_source for frame in frames} == {"chunk" if worn.tells_by_chunks else "ledger"}
            wrong = [frame for frame in frames if abs(frame.pixels.mean() - grey_of(frame.setting)) > 1.5]
            # Those that started during the write: one, unless the machine is busy just then.
            assert len(wrong) <= (0 if worn.tells_by_chunks else 3)
        check_gain(worn, camera)
        check_words(worn, camera)


@pytest.mark.parametrize("worn", WORN, ids=str, indirect=True)
def test_features_are_taken_but_for_those_that_the_driver_writes(worn: Worn, monkeypatch: pytest.MonkeyPatch) -> None:
    written = names_written(monkeypatch)
    setup = replace(set_up(worn), features=parse_features([{"Width": 32}, {"TriggerSelector[FrameStart].Height": 40}]))
    with contextlib.closing(open_camera(worn.serial, setup)) as camera:
        camera.write(ExposureSetting(2000.0, 0.0))
    assert [worn.device.features.get(name) for name in ("Width", "Height")] == [32, 40]
    driven = {name for name in written if advice(FeatureSetting(name, 0), setup, worn.gain_in_db) is not None}
    assert written - driven <= SELECTORS | {"Width", "Height"}
    with open_nodes(worn.serial) as nodes:
        assert set_features(nodes, parse_features([{"Width": 64}, {"Height": 48}])) == []


@pytest.mark.parametrize("worn", range(1, len(COMBINATIONS)), ids=str, indirect=True)
def test_a_write_takes_few_requests(worn: Worn, monkeypatch: pytest.MonkeyPatch) -> None:
    """A node is written and read back; bounds are read, too, where time is not a float in microseconds."""
    with contextlib.closing(open_camera(worn.serial, set_up(worn))) as camera:
        camera.write(ExposureSetting(2000.0, 0.0))
        asked: list[int] = []
        read, write = XmlCamera.read, XmlCamera.write
        monkeypatch.setattr(XmlCamera, "read", lambda it, *range_: (asked.append(0), read(it, *range_))[1])
        monkeypatch.setattr(XmlCamera, "write", lambda it, *data: (asked.append(0), write(it, *data))[1])
        camera.write(ExposureSetting(3000.0, 3.0 if worn.gain_in_db else 0.0))
        requests = len(asked)
    plain = worn.us_per_unit == 1.0 and worn.description.nodes[worn.exposure_time].kind == "Float"
    assert requests == (4 if worn.gain_in_db else 2) + (0 if plain else 2)


@pytest.mark.realtime
@pytest.mark.parametrize("worn", [10, 11, 12, *REAL_ONES[-2:]], ids=str, indirect=True)
def test_the_driver_runs_it_freely_at_a_rate(worn: Worn) -> None:
    """Number 10 and Basler's older ones have a period in the register of the rate."""
    with contextlib.closing(open_camera(worn.serial, CameraSetup(TriggerSetup("free_run", rate_hz=50.0)))) as camera:
        assert worn.device.features.get("AcquisitionFrameRate") == pytest.approx(50.0, rel=0.01)
        camera.start()
        frames = [frame for _ in range(5) if isinstance(frame := camera.next_frame(0.5), Frame)]
        assert np.median(np.diff([frame.device_time_ns for frame in frames])) == pytest.approx(20e6, rel=0.01)


def check_gain(worn: Worn, camera: AravisCamera) -> None:
    setting = ExposureSetting(2000.0, 6.0)
    if worn.gain_in_db:
        assert camera.write(setting).agrees_with(setting)
        assert frames_until(camera, grey_of(setting))[-1].setting.agrees_with(setting)
        return
    assert camera.limits.max_gain_db == 0.0
    with pytest.raises(NodeError, match="no gain known in dB"):
        camera.write(setting)


def check_words(worn: Worn, camera: AravisCamera) -> None:
    """Exactly the camera's limitations are reported."""
    limitations = " / ".join(camera.description.limitations)
    nodes = worn.description.nodes
    has_gain = any(name in nodes and nodes[name].kind != "Category" for name in ("Gain", "GainRaw"))
    assert ("not driven, so that dim light stays dark" in limitations) == (has_gain and not worn.gain_in_db)
    assert ("no gain node" in limitations) == (not has_gain)
    assert ("no TriggerOverlap" in limitations) == ("TriggerOverlap" not in nodes)
    assert ("inferred from when it was written" in limitations) == (not worn.tells_by_chunks)
    assert "gamma" not in limitations
