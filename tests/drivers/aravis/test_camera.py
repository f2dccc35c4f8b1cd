"""What a camera makes of chunks, of refused writes and of a host that fails; no wire."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.aravis import AravisCamera, FoundCamera, opening
from drivers.aravis.camera import ChunkReader, FrameReader
from drivers.aravis.nodes import Aravis
from drivers.aravis.stream import own_bytes_per_s
from drivers.camera import CameraDescription
from drivers.genicam.dialect import find_dialect
from drivers.genicam.metadata import ChunkNodes, SettingLedger
from drivers.genicam.timeline import FrameTimeline
from imaging.errors import CameraBusyError, CameraNotFoundError, NodeError
from imaging.exposure import ExposureSetting
from imaging.pixels import PixelFormat
from tests.drivers.genicam.node_map import FloatNode, IntegerNode, MemoryNodes, Node, StringNode

AT_FIRST = ExposureSetting(1000.0, 0.0)


def test_only_a_setting_that_can_be_is_taken_from_chunks() -> None:
    def read_chunks(exposure_time_us: float, gain_db: float) -> ExposureSetting | None:
        values = {"ExposureTime": exposure_time_us, "Gain": gain_db}
        parser = SimpleNamespace(get_float_value=lambda _, name: values[name])
        return ChunkReader(parser, ChunkNodes("ExposureTime", 1.0, "Gain"), None).setting(
            SimpleNamespace(has_chunks=lambda: True)
        )

    assert read_chunks(1000.0, 6.0) == ExposureSetting(1000.0, 6.0)
    for impossible in (0.0, -1.0, 1e12, math.inf, math.nan):
        assert read_chunks(impossible, 0.0) is None
    for impossible in (7000.0, -7000.0, math.inf, math.nan):
        assert read_chunks(1000.0, impossible) is None


class DirectNodes(MemoryNodes):
    """Without checks anyway, and never silent."""

    silent = threading.Event()
    unchecked = contextlib.nullcontext


def camera_with(ledger: SettingLedger, **others: Node) -> AravisCamera:
    nodes: Any = DirectNodes(others)
    stream: Any = None
    dialect = find_dialect(nodes)
    frames = FrameReader("M1", PixelFormat.MONO8, ledger, FrameTimeline(None, None), None)
    return AravisCamera(
        nodes,
        CameraDescription("Maker", "Model", "M1"),
        limits=dialect.limits(nodes),
        dialect=dialect,
        setting=AT_FIRST,
        stream=stream,
        frames=frames,
    )


def setting_after_refusal(time_node: FloatNode, gain_node: FloatNode, message: str) -> ExposureSetting:
    """The setting of a frame that is taken after the camera refused 8 ms and 30 dB."""
    ledger = SettingLedger(AT_FIRST)
    camera = camera_with(ledger, ExposureTime=time_node, Gain=gain_node)
    with pytest.raises(NodeError, match=message):
        camera.write(ExposureSetting(8000.0, 30.0))
    return ledger.setting_at(time.monotonic_ns())


@pytest.mark.parametrize(
    ("gain", "message", "gain_db"),
    [(FloatNode(0.0, 0.0, 20.0, "dB"), "could not set Gain to 30", 0.0),
     (FloatNode(0.0, 0.0, 40.0, "dB", take=lambda gain_db: min(gain_db, 20.0)), "reads back 20 dB", 20.0)],
)  # fmt: skip
def test_frames_after_a_refused_gain_have_the_setting_that_the_nodes_hold(
    gain: FloatNode, message: str, gain_db: float
) -> None:
    held = setting_after_refusal(FloatNode(1000.0, 10.0, 1e5, "us"), gain, message)
    assert held == ExposureSetting(8000.0, gain_db)


@pytest.mark.parametrize("unusable", [0.0, 1e12, math.inf])
def test_nodes_that_hold_no_setting_after_a_refusal_change_nothing(unusable: float) -> None:
    time_node = FloatNode(1000.0, 10.0, 1e5, "us", take=lambda _: unusable)
    assert setting_after_refusal(time_node, FloatNode(0.0, 0.0, 20.0, "dB"), "could not set Gain") == AT_FIRST


def test_a_camera_that_no_action_command_can_reach_is_refused_by_serial() -> None:
    found = FoundCamera("A1", "Maker", "Model", "gige", "255.255.255.255", "id")
    with pytest.raises(CameraBusyError, match=r"camera A1: .*action command"):
        opening._action_sender(found)


def test_the_temperature_is_what_the_node_says() -> None:
    time_node = FloatNode(1000.0, 10.0, 10000.0, "us")

    def warm_c(**nodes: Node) -> float | None:
        return camera_with(SettingLedger(AT_FIRST), ExposureTime=time_node, **nodes).temperature_c()

    assert warm_c() is None
    assert warm_c(DeviceTemperature=FloatNode(46.5, -40.0, 100.0, "C")) == 46.5
    assert warm_c(DeviceTemperature=FloatNode(math.nan, -40.0, 100.0, "C")) is None
    assert warm_c(DeviceTemperature=StringNode("warm")) is None


def test_the_speed_of_the_link_is_that_of_the_standard_nodes() -> None:
    def speed(**nodes: Node) -> float | None:
        node_map: Any = DirectNodes(dict(nodes))
        return own_bytes_per_s(node_map)

    assert speed() is None
    assert speed(DeviceLinkSpeed=IntegerNode(125_000_000, 0, 1 << 40)) == 125e6
    assert speed(GevLinkSpeed=IntegerNode(1000, 0, 1 << 20)) == 125e6
    assert speed(DeviceLinkSpeed=IntegerNode(0, 0, 1 << 40)) is None


def test_every_class_of_aravis_is_made_before_a_thread_names_it() -> None:
    """PyGObject makes each when it is first named: of two cameras opened at once, one met an enumeration half made."""
    assert {name for name in dir(Aravis) if not name.startswith("__")} <= vars(Aravis).keys()


class Crowd:
    """A lock that none of three has before all want it."""

    def __init__(self) -> None:
        self._all_here, self._lock = threading.Barrier(3), threading.Lock()

    def __enter__(self) -> None:
        self._all_here.wait(20.0)
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def test_who_waits_while_others_search_does_not_search_again(monkeypatch: pytest.MonkeyPatch) -> None:
    searches: list[int] = []
    nothing = SimpleNamespace(update_device_list=lambda: searches.append(0), get_n_devices=lambda: 0)
    stand_ins = {"Aravis": nothing, "ONE_AT_A_TIME": Crowd(), "_searched_s": -math.inf, "_found_s": -math.inf}
    for name, value in stand_ins.items():
        monkeypatch.setattr(opening, name, value)
    with ThreadPoolExecutor(3) as cameras:
        absent = [cameras.submit(opening.find_camera, serial) for serial in ("A1", "A2", "A3")]
    assert [type(one.exception()) for one in absent] == [CameraNotFoundError] * 3
    assert len(searches) == 1
