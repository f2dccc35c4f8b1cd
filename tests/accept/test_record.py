"""A recording of 10 s: other tools open it, and every decision in it is replayed bit for bit."""

from __future__ import annotations

import re
import threading
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from tests.accept.commands import output
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE, running_service
from tests.autoexpose_daemon.stereo import stereo_cameras

RECORDED_S = 10.0


def test_ten_seconds_open_elsewhere_and_are_replayed(tmp_path: Path) -> None:
    path, config = tmp_path / "run.mcap", tmp_path / "rig.yaml"
    with stereo_cameras() as (left, right, _):
        config.write_text(f"cameras: {{left: {{serial: {left.serial}}}, right: {{serial: {right.serial}}}}}")
        with running_service(config, command=["record", str(path)]) as daemon:
            daemon.wait_for("READY=1")
            threading.Event().wait(RECORDED_S)
    seconds = opened_by_mcap(path)
    assert seconds >= RECORDED_S
    opened_by_rosbags(path)
    print(f"{path.stat().st_size / seconds / 1e6:.1f} MB/s")

    said = output(*AUTOEXPOSE, "replay", path)
    print(said)
    steps = re.search(rf"^(\d+) steps of {DEFAULT_POLICY}; missing: 0 dropped", said, re.MULTILINE)
    replayed = re.search(r"^replayed: (\d+), of which \1 are bit for bit as recorded", said, re.MULTILINE)
    assert steps is not None
    assert replayed is not None
    assert int(replayed[1]) == int(steps[1]) - 1 >= 100


def opened_by_mcap(path: Path) -> float:
    """Seconds from the first image to the last."""
    with path.open("rb") as stream:
        times_ns = [
            message.log_time
            for _, _, message in make_reader(stream, validate_crcs=True).iter_messages("/rig/left/image_raw")
        ]
    return (times_ns[-1] - times_ns[0]) * 1e-9


def opened_by_rosbags(path: Path) -> None:
    store = get_typestore(Stores.EMPTY)
    with Reader(path) as reader:
        for connection in reader.connections:
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        for connection, _, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            if connection.topic.endswith("/image_raw"):
                assert (message.height, message.width) == (540, 720)  # type: ignore[attr-defined]
