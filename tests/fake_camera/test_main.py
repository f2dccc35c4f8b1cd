"""The process: ready line, clean end, files and signals, and one sentence for each mistake."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fake_camera.__main__ import _description, main
from fake_camera.device.features import Features
from fake_camera.files import read_regular
from fake_camera.genicam.registers import slots
from fake_camera.options import parse_arguments
from fake_camera.signals import stopped_by_signals, wait_for
from fake_camera.world.lighting import LightScript
from fake_camera.world.scene.panorama import load_radiance
from tests.fake_camera.gige.gige_client import CCP, GvcpClient
from tests.fakes import fake_camera, loopback_address, run_camera, unique, usb3_camera
from tests.xml_cameras import xml_camera

OPTIONS = ["--serial", "FAKE-M", "--address", "127.0.9.1"]
STREAM_PORT, STREAM_ADDRESS = 0x0D00, 0x0D18


@contextlib.contextmanager
def started(*options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A process and its first line; in the end it must stop cleanly at a signal."""
    command = [sys.executable, "-m", "fake_camera", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process, process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=10)
    assert (process.returncode, errors) == (0, "")


@pytest.mark.wire
def test_says_when_it_is_ready_and_ends_cleanly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    truth, control = tmp_path / "truth.jsonl", tmp_path / "control"
    options = ["--line0", "wire", "--line0-rate-hz", "50", "--truth", str(truth), "--control", str(control)]
    with started(*OPTIONS, *options) as (_, ready):
        assert ready == "fake camera FAKE-M (left) at 127.0.9.1, Line0 wire at 50 Hz, scene room\n"
        assert control.is_socket()
    assert [path.name for path in tmp_path.iterdir()] == ["truth.jsonl"]


@pytest.mark.wire
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_while_it_waits_for_the_rate_of_the_wire(number: signal.Signals) -> None:
    options = f"--scene wall --line0 {unique('wire')} --line0-rate-hz ask".split()
    command = [sys.executable, "-m", "fake_camera", *OPTIONS, *options]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as camera:
        assert camera.stdout is not None
        assert ["can_be_found" in camera.stdout.readline(), "frame_s" in camera.stdout.readline()] == [True, True]
        camera.send_signal(number)
        try:
            assert (camera.wait(timeout=10), camera.stderr.read() if camera.stderr else "") == (0, "")
        finally:
            camera.kill()


@pytest.mark.wire
def test_ends_cleanly_in_the_middle_of_sending_through_a_switch(tmp_path: Path) -> None:
    address = loopback_address()
    options = f"--address {address} --scene wall --size 2448x2048 --switch {tmp_path}/switch,1000,512".split()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream,
        GvcpClient(address) as client,
        started(*options),
    ):
        stream.bind(("127.0.0.1", 0))
        stream.settimeout(10)
        start = slots(Features("", 2448, 2048, lambda: 0))["AcquisitionStart"]
        assert client.write(CCP, 2, STREAM_PORT, stream.getsockname()[1], STREAM_ADDRESS, 0x7F000001, start, 1) == 0
        stream.recv(0x10000)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--address localhost", "argument --address: 'localhost' is not an IPv4 address"),
        ("--usb3 --tcp 99999", "argument --tcp: '99999' is not a whole number from 1 to 65535"),
        ("--seed 18446744073709551616", "argument --seed: '18446744073709551616' is not a whole number from 0 to"),
        ("--lens-f-number 0", "argument --lens-f-number: '0' is not a number from 0.5 to 32"),
        ("--ptp 65535", "argument --ptp: '65535' is not a whole number from 1 to 65534"),
        ("ptp-master --port none", "argument --port: 'none' is not a whole number from 1 to 65534"),
        ("--yaw-deg 400", "argument --yaw-deg: '400' is not a number from -360 to 360"),
        ("--sunlit-stops -1", "argument --sunlit-stops: '-1' is not a number from 0 to 10"),
        ("--place above", "argument --place: invalid choice: 'above'"),
        ("--place rear_left --side left", "--place says where the camera is: leave out --side"),
        ("--place rear_left --yaw-deg 0", "leave out --yaw-deg"),
        ("--place rear_left --scene wall", "places but left and right are for the scene `room`"),
        ("--sunlit-stops 1 --scene board", "--sunlit-stops and places"),
        ("--usb3 --tcp --ptp", "--ptp is for GigE Vision cameras: leave it out"),
        ("--seed many", "argument --seed: 'many' is not a whole number"),
        ("--usb3", "--usb3 needs a way to reach the camera: --socket PATH, --tcp or --exec COMMAND"),
        ("--usb3 --address 127.0.9.9 --tcp", "--address is for GigE Vision cameras: leave out"),
        ("--socket camera", "--socket is for USB3 Vision cameras: add --usb3"),
        ("--usb3 --exec", "--exec needs a command"),
        ("--steered", "--steered needs --control SOCKET and --line0 NAME"),
        ("--steered --control c --line0 n --still", "leave out --still and --light"),
    ],
)
def test_an_option_that_cannot_be_is_named(options: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(options.split())
    assert words in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("options", "place", "side", "yaw_deg", "sunlit_stops"),
    [
        ("", "left", "left", 0, 0),
        ("--side right --yaw-deg 90 --sunlit-stops 1", "right", "right", 90, 1),
        ("--place right --scene wall", "right", "right", 0, 0),
        ("--place rear_left", "rear_left", "left", 180, 3),
        ("--place port_right", "port_right", "right", -90, 0),
        ("--place starboard_left", "starboard_left", "left", 90, 0),
    ],
)
def test_a_place_says_side_yaw_and_sun(
    options: str, place: str, side: str, yaw_deg: float, sunlit_stops: float
) -> None:
    found = parse_arguments(options.split())
    assert (found.place, found.side) == (place, side)
    assert (found.yaw_deg, found.sunlit_stops) == (yaw_deg, sunlit_stops)


@pytest.mark.wire
def test_a_ptp_master_says_when_it_is_ready_and_ends_cleanly() -> None:
    with started("ptp-master", "--port", "30319") as (master, ready):
        assert ready == f"PTP master at 127.0.0.1, UDP ports 30319 and 30320, process {master.pid}\n"
        master.send_signal(signal.SIGUSR1)


def test_a_ptp_master_at_no_interface_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ptp-master", "--address", "192.0.2.1"]) == 2
    said = capsys.readouterr().err
    assert "no network interface has the address 192.0.2.1" in said and said.count("\n") == 1


@pytest.mark.parametrize(
    ("serial", "transport", "words"),
    [
        *(
            (serial, wire, "is not a serial number")
            for serial in ("", " ", "L\n", "\x1b[31mL", "\u00e9")
            for wire in ("gige", "usb3")
        ),
        ("1" * 16, "gige", "is too long: GigE Vision allows 15 characters"),
        ("1" * 64, "usb3", "is too long: USB3 Vision allows 63 characters"),
    ],
)
def test_a_serial_number_that_cannot_be_sent_is_refused(
    capsys: pytest.CaptureFixture[str], serial: str, transport: str, words: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--serial", serial, *(["--usb3", "--socket", "x"] if transport == "usb3" else [])])
    assert ended.value.code == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"--serial {serial!r} {words}" in said


@pytest.mark.wire
@pytest.mark.parametrize(("name_space", "wire"), [("GEV", "gige"), ("U3V", "usb3"), ("None", "gige"), ("None", "usb3")])
def test_a_camera_in_a_description_says_what_it_passes_for(tmp_path: Path, name_space: str, wire: str) -> None:
    description = tmp_path / "camera.xml"
    description.write_bytes(b"Nobody\n" + xml_camera(16, name_space))
    with (fake_camera if wire == "gige" else usb3_camera)(options=["--xml", str(description)]) as camera:
        where = f"at {camera.address}" if wire == "gige" else "on USB"
        passes_for = f"Line0 {camera.line0} at 60 Hz, scene room, as Nobody Tiny16, trigger line Line1"
        assert camera.ready == f"fake camera {camera.serial} (left) {where}, {passes_for}\n"


@pytest.mark.wire
@pytest.mark.parametrize(
    ("name_space", "options", "sentence"),
    [
        ("U3V", [], "USB3 Vision camera: add --usb3 and --exec, --socket or --tcp\n"),
        (None, [], "camera.xml: No such file or directory"),
        ("", [], "camera.xml: a GenICam description begins with"),
        ("GEV", ["--usb3", "--socket", "unused"], "GigE Vision camera: leave out --usb3 and its options\n"),
    ],
)
def test_a_bad_description_or_one_of_the_other_transport_is_refused_in_one_sentence(
    tmp_path: Path, name_space: str | None, options: list[str], sentence: str
) -> None:
    if name_space is not None:
        (tmp_path / "camera.xml").write_bytes(xml_camera(16, name_space) if name_space else b"<html/>")
    camera = run_camera("--xml", str(tmp_path / "camera.xml"), *options)
    assert (camera.returncode, camera.stdout) == (2, "")
    assert sentence in camera.stderr
    assert camera.stderr.count("\n") == 1


READERS: tuple[Callable[[Path], object], ...] = (
    LightScript.from_file,
    load_radiance,
    lambda path: _description(path, usb3=False),
)


def test_a_regular_file_is_read_up_to_a_length(tmp_path: Path) -> None:
    path = tmp_path / "notes"
    path.write_bytes(b"x" * 4096)
    assert read_regular(path, 4096) == b"x" * 4096
    with pytest.raises(OSError, match="it is larger than 3 KiB"):
        read_regular(path, 4095)


@pytest.fixture(params=["pipe", ".", "/dev/zero", "/dev/urandom", "/dev/null"])
def odd(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "pipe":
        os.mkfifo(tmp_path / "pipe")
    return tmp_path / str(request.param)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("read", READERS)
def test_pipes_devices_and_folders_are_refused_at_once(read: Callable[[Path], object], odd: Path) -> None:
    with pytest.raises((OSError, ValueError), match="it is not a regular file") as refused:
        read(odd)
    assert str(odd) in str(refused.value)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("read", READERS)
def test_a_file_larger_than_any_is_not_read(read: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises((OSError, ValueError), match="it is larger than"):
        read(path)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_may_come_while_its_event_is_locked(number: signal.Signals) -> None:
    before = {known: signal.getsignal(known) for known in (signal.SIGTERM, signal.SIGINT)}
    try:
        stop = stopped_by_signals()
        with stop._cond:  # as within its wait()
            signal.raise_signal(number)
        assert stop.wait(10)
    finally:
        for known, handler in before.items():
            signal.signal(known, handler)


def test_a_signal_just_before_the_wait_ends_it() -> None:
    """Its handler runs only after a wait has returned."""

    class Interrupted(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            assert timeout is not None, "waits for good"
            was_set = self.is_set()
            self.set()
            return was_set

    stop = Interrupted()
    wait_for(stop)
    assert stop.is_set()
