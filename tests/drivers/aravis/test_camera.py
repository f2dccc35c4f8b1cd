"""What a camera makes of chunks, of refused writes and of a host that fails; no wire."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from types import SimpleNamespace

import pytest

from drivers.aravis import camera
from drivers.aravis.camera import AravisCamera
from drivers.aravis.discovery import FoundCamera
from drivers.genicam.dialect import find_dialect
from drivers.genicam.metadata import SettingLedger
from imaging.errors import CameraBusyError, NodeError
from imaging.exposure import ExposureSetting
from tests.drivers.genicam.node_map import FloatNode, MemoryNodes

AT_FIRST = ExposureSetting(1000.0, 0.0)


def read_chunks(exposure_time_us: float, gain_db: float) -> ExposureSetting | None:
    values = {"ExposureTime": exposure_time_us, "Gain": gain_db}
    device = AravisCamera.__new__(AravisCamera)
    device._chunk_nodes = SimpleNamespace(  # type: ignore[assignment]
        exposure_time="ExposureTime", gain="Gain", us_per_unit=1.0, gain_is_integer=False
    )
    device._chunks = SimpleNamespace(get_float_value=lambda _, name: values[name])
    device._dialect = SimpleNamespace(gain=None)  # type: ignore[assignment]
    return device._read_chunks(SimpleNamespace(has_chunks=lambda: True))


def test_only_a_setting_that_can_be_is_taken_from_chunks() -> None:
    assert read_chunks(1000.0, 6.0) == ExposureSetting(1000.0, 6.0)
    for impossible in (0.0, -1.0, 1e12, math.inf, math.nan):
        assert read_chunks(impossible, 0.0) is None
    for impossible in (7000.0, -7000.0, math.inf, math.nan):
        assert read_chunks(1000.0, impossible) is None


def without_chunks(time_node: FloatNode, gain_node: FloatNode) -> AravisCamera:
    nodes = MemoryNodes({"ExposureTime": time_node, "Gain": gain_node})
    device = AravisCamera.__new__(AravisCamera)
    device._nodes = nodes  # type: ignore[assignment]
    device._nodes.silent = threading.Event()
    device._nodes.unchecked = contextlib.nullcontext  # type: ignore[method-assign]
    device._closed = threading.Event()
    device._dialect = find_dialect(nodes)
    device._setting = device._dialect.read(nodes)
    device._ledger = SettingLedger(device._setting)
    return device


def setting_after_refusal(device: AravisCamera, asked: ExposureSetting, message: str) -> ExposureSetting:
    """The setting of a frame that is taken after the camera refused `asked`."""
    with pytest.raises(NodeError, match=message):
        device.write(asked)
    return device._ledger.setting_at(time.monotonic_ns())


@pytest.mark.parametrize(
    ("gain", "message", "gain_db"),
    [(FloatNode(0.0, 0.0, 20.0, "dB"), "could not set Gain to 30", 0.0),
     (FloatNode(0.0, 0.0, 40.0, "dB", take=lambda gain_db: min(gain_db, 20.0)), "reads back 20 dB", 20.0)],
)  # fmt: skip
def test_frames_after_a_refused_gain_have_the_setting_that_the_nodes_hold(
    gain: FloatNode, message: str, gain_db: float
) -> None:
    device = without_chunks(FloatNode(1000.0, 10.0, 1e5, "us"), gain)
    assert setting_after_refusal(device, ExposureSetting(8000.0, 30.0), message) == ExposureSetting(8000.0, gain_db)


@pytest.mark.parametrize("unusable", [0.0, 1e12, math.inf])
def test_nodes_that_hold_no_setting_after_a_refusal_change_nothing(unusable: float) -> None:
    time_node = FloatNode(1000.0, 10.0, 1e5, "us", take=lambda _: unusable)
    device = without_chunks(time_node, FloatNode(0.0, 0.0, 20.0, "dB"))
    assert setting_after_refusal(device, ExposureSetting(8000.0, 30.0), "could not set Gain to 30") == AT_FIRST


def test_a_camera_that_no_action_command_can_reach_is_refused_in_a_sentence() -> None:
    found = FoundCamera("A1", "Maker", "Model", "gige", "255.255.255.255", "id")
    with pytest.raises(CameraBusyError, match="camera A1: no action command could be sent: ") as refused:
        camera._action_sender(found)
    assert refused.value.__context__ is None
