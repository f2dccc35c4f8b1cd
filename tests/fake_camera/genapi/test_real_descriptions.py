"""Every real description makes a camera that can be driven: what it offers has limits that hold its value."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from fake_camera.device.device import Device
from fake_camera.genapi.description import Description
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.xml_camera import XmlCamera
from tests.data import DATA, data
from tests.fake_camera.gige.gige_client import Ramp

pytestmark = pytest.mark.data

NAMES = sorted(str(path.relative_to(DATA)) for path in DATA.glob("genicam_xml/**/*.xml"))
NUMBERS = (
    *("ExposureTime", "ExposureTimeAbs", "ExposureTimeBaseAbs", "Gain", "GainAbs", "GainRaw", "Gamma"),
    *("Width", "Height", "OffsetX", "OffsetY", "AcquisitionFrameRate", "AcquisitionFrameRateAbs", "GevSCPSPacketSize"),
)
ALWAYS_0 = {"OffsetX", "OffsetY"}
"""While the image is as large as the sensor."""


@pytest.fixture(params=NAMES)
def worn(request: pytest.FixtureRequest) -> Iterator[XmlCamera]:
    path: Path = data(request.param)
    with closing(Device(Ramp(), "X1")) as device:
        yield XmlCamera(Description.from_bytes(path.read_bytes(), path.name), device)


def test_there_are_descriptions() -> None:
    assert len(NAMES) >= 55


def test_what_it_drives_has_limits_that_hold_its_value_and_a_smaller_image_has_room_to_move(worn: XmlCamera) -> None:
    camera = Evaluator(worn.description, worn)
    parts = [part for node in worn.description.nodes.values() for part in node.parts.get("pFeature", [])]
    offered = {(part.text or "").strip() for part in parts}
    there = [name for name in NUMBERS if name in offered and camera.kind(name) not in (None, "Category")]
    assert worn.not_available == ()
    assert {"Width", "Height"} < set(there)
    assert {"ExposureTime", "ExposureTimeAbs"} & set(there)
    for name in there:
        value, (low, high), step = camera.value(name), camera.limits(name), camera.bound(name, "Inc")
        assert low <= value <= high, name
        assert low < high or name in ALWAYS_0, name
        assert step is None or step > 0, name
        if step is not None and math.isfinite(low):
            assert abs((value - low) / step - round((value - low) / step)) < 1e-5, name
    for name in ("TriggerMode", "TriggerSource"):
        entries = {entry.integer("Value", 0) for entry in camera.node(name).entries.values()}
        assert camera.value(name) in entries
    for size, offset in (("Width", "OffsetX"), ("Height", "OffsetY")):
        camera.set(size, camera.limits(size)[0])
        assert camera.limits(offset)[1] > 0
