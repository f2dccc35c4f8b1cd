"""What every camera opened through Aravis must do, whatever its transport.

Runs directly over GigE Vision; test_on_usb3.py runs it again in a process with fakes on its USB bus.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from drivers.aravis import AravisCamera, find_cameras, open_camera, open_nodes, opening
from drivers.aravis.opening import FoundCamera
from drivers.camera import IncompleteFrame
from drivers.genicam.features import advice, differing, read_inventory
from drivers.genicam.timeline import LATCH_ERROR_NS
from drivers.setup import CameraSetup, FeatureSetting, TriggerSetup, parse_features
from fake_camera.device.faults import Fault
from fake_camera.usb3.run import CAMERAS_VARIABLE
from imaging.errors import (
    AutoexposeError,
    CameraBusyError,
    CameraLostError,
    CameraNotFoundError,
    ConfigurationError,
    NodeError,
)
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.pixels import PixelFormat
from tests.drivers import test_camera_contract as camera_contract
from tests.drivers.aravis.grey_card import SELECTORS, names_written
from tests.drivers.test_camera_contract import CameraContract
from tests.fakes import FakeCamera, camera_on_this_bus, fake_camera
from tests.meanwhile import wait_until

pytestmark = pytest.mark.wire

RATE_HZ = 60.0
PERIOD_NS = 1e9 / RATE_HZ
EXTERNAL = TriggerSetup("external", "Line0", RATE_HZ)
SOFTWARE = TriggerSetup("software", rate_hz=RATE_HZ)
PATIENCE_S = 20.0
ATTEMPTS = 3


@dataclass(frozen=True)
class Backend:
    transport: str
    start: Callable[..., contextlib.AbstractContextManager[FakeCamera]]


BACKENDS = [Backend("usb3", camera_on_this_bus) if CAMERAS_VARIABLE in os.environ else Backend("gige", fake_camera)]


@pytest.fixture(scope="module", params=BACKENDS, ids=lambda backend: backend.transport)
def backend(request: pytest.FixtureRequest) -> Backend:
    chosen: Backend = request.param
    return chosen


@pytest.fixture(scope="module")
def fake(backend: Backend) -> Iterator[FakeCamera]:
    with backend.start() as running:
        yield running


@pytest.fixture(scope="module")
def idle(backend: Backend) -> Iterator[FakeCamera]:
    """A second camera, never left open between tests."""
    with backend.start() as running:
        yield running


@pytest.fixture
def another(backend: Backend) -> Iterator[FakeCamera]:
    with backend.start() as running:
        yield running


@pytest.fixture(scope="module")
def streaming(fake: FakeCamera) -> Iterator[AravisCamera]:
    with opened(fake) as camera:
        camera.start()
        yield camera


@pytest.fixture
def camera(streaming: AravisCamera) -> AravisCamera:
    """The shared camera at a known setting, older frames drained."""
    streaming.write(ExposureSetting(2000.0, 0.0))
    frames_until(streaming, lambda frame: frame.setting == ExposureSetting(2000.0, 0.0))
    return streaming


@contextlib.contextmanager
def opened(fake: FakeCamera, **setup: Any) -> Iterator[AravisCamera]:
    camera = open_camera(fake.serial, CameraSetup(**{"trigger": EXTERNAL, **setup}))
    with contextlib.closing(camera):
        yield camera


@dataclass(frozen=True)
class AravisBench:
    """Triggers run anyway."""

    camera: AravisCamera

    def pulse(self) -> None:
        pass


def frames_until(camera: AravisCamera, enough: Callable[[Frame], bool]) -> list[Frame]:
    return camera_contract.frames_until(AravisBench(camera), enough)  # type: ignore[arg-type]


def next_frames(camera: AravisCamera, count: int) -> list[Frame]:
    return camera_contract.next_frames(AravisBench(camera), count)  # type: ignore[arg-type]


def in_a_row(camera: AravisCamera, count: int) -> list[Frame]:
    """The first run of that many frames without a gap: a busy machine loses some."""
    frames: list[Frame] = []

    def enough(frame: Frame) -> bool:
        if frames and frame.frame_id != frames[-1].frame_id + 1:
            frames.clear()
        frames.append(frame)
        return len(frames) == count

    frames_until(camera, enough)
    return frames


class TestAravisCamera(CameraContract):
    @pytest.fixture
    def bench(self, idle: FakeCamera) -> Iterator[AravisBench]:
        with opened(idle) as camera:
            yield AravisBench(camera)

    def test_a_vanished_camera_is_lost_and_can_be_closed(self, backend: Backend) -> None:  # type: ignore[override]
        """And reopened meanwhile: closing it takes up to 10 s."""
        with backend.start() as fake, opened(fake) as camera:
            camera.start()
            next_frames(camera, 5)
            fake.inject(Fault.VANISH, count=None)
            with contextlib.suppress(CameraLostError):  # over USB the first call that times out may raise it
                while isinstance(camera.next_frame(0.2), Frame | IncompleteFrame):
                    pass
            with pytest.raises(CameraLostError, match=fake.serial):
                camera.write(ExposureSetting(3000.0, 0.0))
            with pytest.raises(CameraLostError):
                camera.next_frame(0.2)
            closing = threading.Thread(target=camera.close)  # it waits for answers that never come
            closing.start()
            fake.inject(Fault.COME_BACK)
            with opened(fake) as again:
                again.start()
                assert next_frames(again, 5)[-1].frame_id < 100
                closing.join(PATIENCE_S)
                assert not closing.is_alive()
                next_frames(again, 5)


def test_cameras_are_found_by_serial(backend: Backend, fake: FakeCamera, idle: FakeCamera) -> None:
    found = {camera.serial: camera for camera in find_cameras()}
    assert found[fake.serial].transport == found[idle.serial].transport == backend.transport
    assert found[fake.serial].id != found[idle.serial].id


def test_an_unknown_serial_is_reported_with_those_that_answer(fake: FakeCamera) -> None:
    with pytest.raises(CameraNotFoundError, match=rf'"NOBODY" answers.*"{fake.serial}"'):
        open_camera("NOBODY", CameraSetup(EXTERNAL))


@pytest.mark.realtime
def test_frames_stay_on_the_trigger_grid_without_a_gap_and_across_latches(camera: AravisCamera) -> None:
    frames = in_a_row(camera, 10)
    looks = {(frame.pixels.shape, frame.pixels.dtype, frame.bit_depth) for frame in frames}
    assert looks == {((540, 720), np.dtype(np.uint8), 8)}
    assert np.median(np.diff([frame.device_time_ns for frame in frames])) == pytest.approx(PERIOD_NS, rel=0.02)
    camera.latch_clock()
    frames += next_frames(camera, 10)
    triggers = np.array([frame.frame_id - frames[0].frame_id for frame in frames])
    error_ns = np.array([frame.host_time_ns - frames[0].host_time_ns for frame in frames]) - triggers * PERIOD_NS
    assert np.median(np.abs(error_ns)) < 2e6
    assert all(frame.host_time_ns + frame.setting.exposure_time_us * 1e3 < frame.arrival_time_ns for frame in frames)


def test_it_says_how_warm_it_is(camera: AravisCamera) -> None:
    assert camera.temperature_c() == 46.0


def test_rounding_is_read_back(camera: AravisCamera) -> None:
    assert camera.description.limitations == ()
    assert camera.description_xml.rstrip().endswith("</RegisterDescription>")
    taken = camera.write(ExposureSetting(2345.4, 0.0))
    assert taken.exposure_time_us != 2345.4
    assert taken.exposure_time_us == pytest.approx(2345.4, abs=camera.limits.time_step_us)


@pytest.mark.parametrize(
    ("setting", "node"),
    [(ExposureSetting(1.0, 0.0), "ExposureTime"), (ExposureSetting(1e9, 0.0), "ExposureTime"),
     (ExposureSetting(2000.0, 99.0), "Gain"), (ExposureSetting(2000.0, -3.0), "Gain")],
)  # fmt: skip
def test_values_out_of_bounds_are_refused_by_name(camera: AravisCamera, setting: ExposureSetting, node: str) -> None:
    with pytest.raises(NodeError, match=rf"{camera.description.serial}.*{node}"):
        camera.write(setting)


@pytest.mark.parametrize("value", [1 << 63, -(1 << 63) - 1])
def test_a_number_that_fits_into_no_node_is_refused_by_name(idle: FakeCamera, value: int) -> None:
    with (
        open_nodes(idle.serial) as nodes,
        pytest.raises(NodeError, match=f"could not set Width to {value}: it takes "),
    ):
        nodes.write("Width", value)


def test_a_refused_write_is_reported_and_the_next_one_writes_everything(fake: FakeCamera, camera: AravisCamera) -> None:
    fake.inject(Fault.REFUSE_WRITES, count=1)
    with pytest.raises(CameraBusyError, match="ExposureTime"):
        camera.write(ExposureSetting(3000.0, 3.0))
    taken = camera.write(ExposureSetting(2000.0, 3.0))
    assert taken.exposure_time_us == 2000.0
    frames_until(camera, lambda frame: frame.setting == taken)


@pytest.mark.realtime
@pytest.mark.gige_only  # USB resends by itself, invisibly to programs
def test_lost_packets_are_requested_again(fake: FakeCamera, camera: AravisCamera) -> None:
    def lost_none() -> bool:
        before = next_frames(camera, 1)[0].frame_id
        fake.inject(Fault.LOSE_PACKETS, count=3)
        return next_frames(camera, 10)[-1].frame_id == before + 10

    assert any(lost_none() for _ in range(ATTEMPTS))  # a busy machine loses some whole frames


def test_frames_lost_whole_leave_a_gap_in_the_ids(backend: Backend, fake: FakeCamera, camera: AravisCamera) -> None:
    before = next_frames(camera, 1)[0].frame_id
    if backend.transport == "usb3":
        fake.inject(Fault.FREEZE, count=2)
    else:
        fake.inject(Fault.LOSE_PACKETS, count=80)
    frames = next_frames(camera, 30)
    gaps = np.diff([before, *(frame.frame_id for frame in frames)]) - 1
    assert np.all(gaps >= 0)
    assert gaps.sum() >= 1


def test_binning_uses_the_whole_sensor_and_can_be_undone(idle: FakeCamera) -> None:
    for binning, shape in ((2, (270, 360)), (1, (540, 720))):
        with opened(idle, binning=binning, pixel_format=PixelFormat.MONO8) as camera:
            camera.start()
            assert next_frames(camera, 1)[0].pixels.shape == shape


def test_a_camera_without_ptp_is_refused_in_a_sentence(backend: Backend, idle: FakeCamera) -> None:
    why = {
        "gige": "it has no ActionDeviceKey, and so takes no action",
        "usb3": "is on USB3 Vision, where there is no PTP",
    }
    with pytest.raises(AutoexposeError, match=f"camera {idle.serial}:? {why[backend.transport]}"):
        open_camera(idle.serial, CameraSetup(TriggerSetup("ptp", rate_hz=RATE_HZ)))


@pytest.mark.realtime
def test_a_software_trigger_takes_one_frame_at_once(idle: FakeCamera) -> None:
    with opened(idle, trigger=SOFTWARE) as camera:
        camera.start()
        assert camera.next_frame(0.1) is None
        frame = None
        while frame is None:  # on a busy machine the fake drops some
            before_ns = time.monotonic_ns()
            camera.trigger()
            frame = camera.next_frame(0.5)
        assert isinstance(frame, Frame)
        assert before_ns - LATCH_ERROR_NS < frame.host_time_ns < frame.arrival_time_ns
        assert camera.next_frame(0.1) is None


WAYS = [
    {"pixel_format": PixelFormat.MONO8},
    {"trigger": SOFTWARE},
    {"trigger": TriggerSetup("free_run", rate_hz=40.0), "binning": 1},
    {"trigger": TriggerSetup("free_run", rate_hz=40.0, output_line="Line1"), "packet_size_bytes": 1500},
]


@pytest.mark.parametrize("way", WAYS)
def test_whatever_it_drives_is_refused_among_features(
    idle: FakeCamera, way: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    refuses_what_it_drives(idle, way, names_written(monkeypatch))


@pytest.mark.gige_only
def test_what_ptp_needs_is_refused_among_features(monkeypatch: pytest.MonkeyPatch) -> None:
    written = names_written(monkeypatch)
    port = random.SystemRandom().randrange(20_000, 30_000, 2)
    with fake_camera(options=["--ptp", str(port)]) as fake:
        refuses_what_it_drives(fake, {"trigger": TriggerSetup("ptp", rate_hz=RATE_HZ)}, written)
    assert {"PtpEnable", "ActionDeviceKey", "ActionGroupKey", "ActionGroupMask"} <= written


def refuses_what_it_drives(fake: FakeCamera, way: dict[str, Any], written: set[str]) -> None:
    with opened(fake, **way) as camera:
        for setting in (ExposureSetting(3000.0, 3.0), ExposureSetting(2000.0, 0.0)):
            camera.write(setting)
        camera.latch_clock()
        if way.get("trigger") == SOFTWARE:
            camera.trigger()
    setup = CameraSetup(**{"trigger": EXTERNAL, **way})
    assert {"ExposureTime", "Gain", "TriggerMode", "ChunkEnable"} <= written
    assert {name for name in written if advice(FeatureSetting(name, 0), setup, True) is None} <= SELECTORS


def test_features_are_set_before_everything_else_and_selectors_put_back(idle: FakeCamera) -> None:
    features = parse_features(
        [
            {"OffsetY": 100},
            {"Width": 320},
            {"OffsetX": 400},
            {"Height": 200},
            {"LineSelector[Line3].LineInverter": True},
        ]
    )
    with opened(idle, features=features) as camera:
        camera.start()
        assert next_frames(camera, 1)[0].pixels.shape == (200, 320)
    with open_nodes(idle.serial) as nodes:
        assert nodes.read("LineSelector") != "Line3"
        assert differing(nodes, features) == []
        assert set(features) <= set(read_inventory(nodes).settings)
        assert differing(nodes, features) == []
    with pytest.raises(ConfigurationError, match=r"features: Widht: .*; did you mean Width\?"):
        open_camera(idle.serial, CameraSetup(EXTERNAL, features=parse_features([{"Widht": 320}])))
    with opened(idle, features=parse_features([{"UserSetSelector": "Default"}, {"UserSetLoad": "execute"}])) as camera:
        camera.start()
        assert next_frames(camera, 1)[0].pixels.shape == (540, 720)


HOLDER = """
import sys, time
from drivers.aravis import open_camera
from drivers.setup import CameraSetup, TriggerSetup
camera = open_camera(sys.argv[1], CameraSetup(TriggerSetup("external")))
camera.start()
print("held", flush=True)
time.sleep(60)
"""


@contextlib.contextmanager
def holder(serial: str) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the camera open and running."""
    with subprocess.Popen([sys.executable, "-c", HOLDER, serial], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        try:
            yield process
        finally:
            process.kill()


def test_a_camera_held_by_another_program_is_busy_until_that_is_killed_and_forgotten(idle: FakeCamera) -> None:
    """Over GigE Vision that takes 3 s."""
    with holder(idle.serial) as process:
        with pytest.raises(CameraBusyError, match=idle.serial):
            open_camera(idle.serial, CameraSetup(EXTERNAL))
        process.send_signal(signal.SIGKILL)
        process.wait()
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            try:
                camera = open_camera(idle.serial, CameraSetup(EXTERNAL))
                break
            except CameraBusyError:
                assert time.monotonic() < deadline_s
        with contextlib.closing(camera):
            camera.start()
            next_frames(camera, 5)


def test_cameras_opened_at_the_same_moment_are_whole(another: FakeCamera, idle: FakeCamera) -> None:
    """Aravis parses a description twice, and does not bear two at once: without the lock the process ends here."""
    with ThreadPoolExecutor(2) as pool:
        for _ in range(8):
            tasks = [pool.submit(open_camera, one.serial, CameraSetup(SOFTWARE)) for one in (another, idle)]
            limits = []
            for one in tasks:
                with contextlib.closing(one.result(PATIENCE_S)) as camera:
                    limits.append(camera.limits)
            assert limits[0] == limits[1]


def test_a_camera_that_answers_slowly_holds_up_no_other(
    another: FakeCamera, idle: FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    reached, go_on = threading.Event(), threading.Event()

    def set_up(nodes: Any, found: FoundCamera, setup: CameraSetup) -> AravisCamera:
        if found.serial == another.serial:
            reached.set()
            assert go_on.wait(PATIENCE_S)
        return original(nodes, found, setup)

    original = opening.set_up
    monkeypatch.setattr(opening, "set_up", set_up)
    with ThreadPoolExecutor(1) as pool:
        slow = pool.submit(open_camera, another.serial, CameraSetup(SOFTWARE))
        assert reached.wait(PATIENCE_S)
        with opened(idle):
            go_on.set()
        slow.result(PATIENCE_S).close()


def test_closing_ends_a_wait(idle: FakeCamera) -> None:
    outcome: list[str] = []

    def read(camera: AravisCamera) -> None:
        try:
            while True:
                camera.next_frame(0.2)
        except CameraLostError as error:
            outcome.append(str(error))

    with opened(idle) as camera:
        camera.start()
        reader = threading.Thread(target=read, args=(camera,))
        reader.start()
        next_frames(camera, 1)
        camera.close()
        reader.join(PATIENCE_S)
        assert outcome == [f"camera {idle.serial} is closed"]


def held() -> tuple[int, int]:
    """Open files and threads of this process."""
    return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))  # noqa: PTH208


def test_opening_and_closing_repeatedly_leaks_nothing(idle: FakeCamera) -> None:
    counts: list[tuple[int, int]] = []
    kept_errors: list[object] = []
    for _ in range(3):
        with opened(idle) as camera:
            camera.start()
            next_frames(camera, 2)
            with pytest.raises(NodeError) as refusal:
                camera.write(ExposureSetting(1e9, 0.0))
        kept_errors.append(refusal)
        counts.append(held())
        wait_until(lambda: all(now <= first for now, first in zip(held(), counts[0], strict=True)))
    for setup in (CameraSetup(EXTERNAL, binning=64), CameraSetup(EXTERNAL, features=parse_features([{"Width": 1}]))):
        with pytest.raises(ConfigurationError) as misfit:
            open_camera(idle.serial, setup)
        kept_errors.append(misfit)
    wait_until(lambda: all(now <= first for now, first in zip(held(), counts[0], strict=True)))
