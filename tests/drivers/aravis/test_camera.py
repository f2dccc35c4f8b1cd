"""What a camera makes of chunks and of a host that fails; no wire."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from drivers.aravis import camera
from drivers.aravis.camera import AravisCamera
from drivers.aravis.discovery import FoundCamera
from drivers.errors import NodeError
from drivers.exposure import ExposureSetting


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


def test_a_camera_that_no_action_command_can_reach_is_refused_in_a_sentence() -> None:
    found = FoundCamera("A1", "Maker", "Model", "gige", "255.255.255.255", "id")
    with pytest.raises(NodeError, match="camera A1: no action command could be sent: Permission denied") as refused:
        camera._action_sender(found)
    assert refused.value.__context__ is None
