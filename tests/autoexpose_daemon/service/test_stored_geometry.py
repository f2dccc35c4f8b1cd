"""A camera's geometry that was set while the daemon ran is in use from then on, and after a restart."""

from __future__ import annotations

import json
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml

from autoexpose_daemon.client import AutoexposeError, MessageClient
from autoexpose_daemon.config.request import new_request
from autoexpose_daemon.messages.frames import read_camera_info
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.service.service import add_outlets
from autoexpose_daemon.service.stored_geometry import StoredGeometry
from imaging.errors import ConfigurationError
from imaging.geometry import CameraGeometry
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint
from tests.autoexpose_daemon.scripted import SHAPE, ScriptedRig, config
from tests.calibration.geometry.written import small_ros
from tests.meanwhile import meanwhile

HEIGHT, WIDTH = SHAPE
BASELINE_M = 0.08


def asked(focal_px: float, baseline_m: float = 0.0, **others: Any) -> dict[str, Any]:
    p = [focal_px, 0.0, 90.0, -focal_px * baseline_m, 0.0, focal_px, 68.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    k = [focal_px, 0.0, 90.0, 0.0, focal_px, 68.0, 0.0, 0.0, 1.0]
    r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    size = {"width": WIDTH, "height": HEIGHT}
    return {**size, "distortion_model": "plumb_bob", "d": [0.0] * 5, "k": k, "r": r, "p": p, **others}


class Visitor:
    """What a consumer hears of a daemon, and asks it."""

    def __init__(self, client: MessageClient) -> None:
        self.client = client
        self.statuses: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._infos: dict[str, queue.SimpleQueue[bytes]] = {}
        client.subscribe("status", self.statuses.put)
        for camera in ("left", "right"):
            self._infos[camera] = queue.SimpleQueue()
            client.subscribe(f"{camera}/camera_info", self._infos[camera].put)

    def wait_for_decisions(self) -> None:
        while json.loads(self.statuses.get(timeout=PATIENCE_S))["decision"] is None:
            pass

    def set(self, **geometry: Any) -> None:
        self.client.ask({"by": "test", "geometry": geometry})

    def focal_px(self, camera: str) -> float | None:
        """That of the newest message: the queue is emptied first."""
        infos = self._infos[camera]
        while not infos.empty():
            infos.get()
        infos.get(timeout=PATIENCE_S)
        found = read_camera_info(infos.get(timeout=PATIENCE_S))
        return None if found is None else found.camera_matrix[0]

    def pose(self, camera: str) -> Any:
        while not self.statuses.empty():
            self.statuses.get()
        self.statuses.get(timeout=PATIENCE_S)
        return json.loads(self.statuses.get(timeout=PATIENCE_S))["cameras"][camera]["pose"]


@contextmanager
def visited(store: StoredGeometry, **sections: Any) -> Iterator[Visitor]:
    at = endpoint()
    configuration = store.applied(config(publish={"listen": [at]}, control={"policy": "neves2009"}, **sections))
    with ScriptedRig(configuration.cameras) as rig:
        daemon = add_outlets(Daemon(configuration, rig.openers), configuration, geometry=store)
        with meanwhile(daemon.run), MessageClient("rig", [at]) as client:
            visitor = Visitor(client)
            visitor.wait_for_decisions()
            yield visitor


@pytest.mark.wire
def test_what_is_set_is_used_at_once_and_after_a_restart(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    store = StoredGeometry(tmp_path)
    with visited(store) as visitor:
        assert visitor.focal_px("left") is None
        visitor.set(left=asked(200.0))
        visitor.set(right=asked(200.0, BASELINE_M))
        assert (visitor.focal_px("left"), visitor.focal_px("right")) == (200.0, 200.0)
        assert visitor.pose("right") == {
            "of": "left", "translation_m": [BASELINE_M, 0.0, 0.0], "rotation_xyzw": [0.0, 0.0, 0.0, 1.0]
        }  # fmt: skip
        assert visitor.pose("left") is None
        file = tmp_path / "rig/left.yaml"
        assert f"geometry of test, stored in {file}" in caplog.text
        with pytest.raises(AutoexposeError, match=r"geometry\.left.*frames of 240x160"):
            visitor.set(left=asked(200.0, width=240, height=160))
        with pytest.raises(AutoexposeError, match="baseline"):
            visitor.set(right=asked(200.0))
        with pytest.raises(AutoexposeError, match="no back camera"):
            visitor.set(back=asked(200.0))
        visitor.client.ask({"by": "test", "reset": True})  # ends requests, not geometry
        assert visitor.focal_px("left") == 200.0
    with visited(StoredGeometry(tmp_path)) as visitor:
        assert (visitor.focal_px("left"), visitor.focal_px("right")) == (200.0, 200.0)


@pytest.mark.wire
def test_another_calibration_arrives_one_camera_after_the_other(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = StoredGeometry(tmp_path)
    with visited(store) as visitor:
        visitor.set(left=asked(200.0), right=asked(200.0, BASELINE_M))
        visitor.set(left=asked(210.0))
        assert (visitor.focal_px("left"), visitor.focal_px("right")) == (210.0, None)
        assert "right camera: its geometry does not fit" in caplog.text
        visitor.set(right=asked(210.0, BASELINE_M))
        assert visitor.focal_px("right") == 210.0


def camera_files(folder: Path) -> dict[str, Any]:
    cameras = {}
    for camera, serial in (("left", "L"), ("right", "R")):
        file = folder / f"configured-{camera}.yaml"
        file.write_text(yaml.safe_dump(small_ros(camera, WIDTH, HEIGHT)))
        cameras[camera] = {"serial": serial, "calibration": file}
    return cameras


@pytest.mark.wire
def test_it_takes_the_place_of_the_configured_file(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """And the other camera's file goes, as it is of another calibration."""
    cameras = camera_files(tmp_path)
    store = StoredGeometry(tmp_path)
    with visited(store, cameras=cameras) as visitor:
        assert visitor.focal_px("right") is not None
        visitor.set(left=asked(200.0))
        assert (visitor.focal_px("left"), visitor.focal_px("right")) == (200.0, None)
    with visited(store, cameras=cameras) as visitor:
        assert (visitor.focal_px("left"), visitor.focal_px("right")) == (200.0, None)
    assert "configured-right.yaml is not used beside" in caplog.text


def kept(folder: Path, serial: str = "L") -> Path:
    file = folder / "rig/left.yaml"
    file.parent.mkdir(exist_ok=True)
    file.write_text(yaml.safe_dump({**small_ros("left", WIDTH, HEIGHT), "serial": serial}))
    return file


def test_what_was_set_for_another_camera_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    kept(tmp_path, serial="X")
    assert StoredGeometry(tmp_path).applied(config()).cameras["left"].calibration is None
    assert "left.yaml is not used: serial is X" in caplog.text


def test_a_damaged_file_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    kept(tmp_path).write_text("{")
    assert StoredGeometry(tmp_path).applied(config()).cameras["left"].calibration is None
    assert "left.yaml is not used" in caplog.text


def test_a_stored_file_is_that_of_the_configuration(tmp_path: Path) -> None:
    file = kept(tmp_path)
    applied = StoredGeometry(tmp_path).applied(config())
    assert applied.cameras["left"].calibration == file
    assert isinstance(applied.calibrations["left"], CameraGeometry)
    assert applied.cameras["right"] == config().cameras["right"]


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"STATE_DIRECTORY": "/var/lib/autoexpose:/other"}, "/var/lib/autoexpose/geometry"),
        ({"XDG_STATE_HOME": "/state"}, "/state/autoexpose/geometry"),
        ({"HOME": "/home/me"}, "/home/me/.local/state/autoexpose/geometry"),
        ({"HOME": "/home/me", "XDG_STATE_HOME": "not/absolute"}, "/home/me/.local/state/autoexpose/geometry"),
    ],
)
def test_it_is_in_the_state_folder(
    variables: dict[str, str], folder: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert StoredGeometry.in_state_folder() == StoredGeometry(Path(folder))


@pytest.mark.parametrize(
    "wrong",
    [
        {"geometry": {}},
        {"geometry": {"left": None}},
        {"geometry": {"left": asked(200.0)}, "locked": True},
        {"geometry": {"left": asked(200.0)}, "group": "all"},
        {"geometry": {"left": asked(float("nan"))}},
        {"geometry": {"left": asked(200.0, k=[1.0])}},
        {"geometry": {"left": asked(200.0, width=0)}},
        {"geometry": {"left": asked(200.0, binning=2)}},
    ],
)
def test_a_request_is_checked(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="geometry"):
        new_request({"by": "test", **wrong})


@pytest.mark.wire
def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "rig").write_text("a file in its place")
    with visited(StoredGeometry(tmp_path)) as visitor:
        with pytest.raises(AutoexposeError, match="cannot be stored"):
            visitor.set(left=asked(200.0))
        assert visitor.focal_px("left") is None


def test_without_a_folder_nothing_is_stored() -> None:
    assert StoredGeometry(None).applied(config()) == config()
