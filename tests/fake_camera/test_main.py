"""The process: ready line, clean end, and one sentence for each mistake."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from fake_camera.__main__ import main
from fake_camera.device.features import Features
from fake_camera.genicam.registers import slots
from tests.fake_camera.gige.gige_client import CCP, GvcpClient
from tests.fakes import fake_camera, loopback_address, run_camera, unique, usb3_camera
from tests.xml_cameras import xml_camera

OPTIONS = ["--serial", "FAKE-M", "--address", "127.0.9.1"]
COMMAND = [sys.executable, "-m", "fake_camera", *OPTIONS]
STREAM_PORT, STREAM_ADDRESS = 0x0D00, 0x0D18


@pytest.mark.wire
def test_says_when_it_is_ready_and_ends_cleanly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    truth, control = tmp_path / "truth.jsonl", tmp_path / "control"
    options = ["--line0", "wire", "--line0-rate-hz", "50", "--truth", str(truth), "--control", str(control)]
    with subprocess.Popen([*COMMAND, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as camera:
        assert camera.stdout is not None
        ready = camera.stdout.readline()
        assert ready == "fake camera FAKE-M (left) at 127.0.9.1, Line0 wire at 50 Hz, scene room\n"
        assert control.is_socket()
        camera.send_signal(signal.SIGTERM)
        _, errors = camera.communicate(timeout=10)
    assert (camera.returncode, errors) == (0, "")
    assert [path.name for path in tmp_path.iterdir()] == ["truth.jsonl"]


@pytest.mark.wire
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_while_it_waits_for_the_rate_of_the_wire(number: signal.Signals) -> None:
    command = [*COMMAND, "--scene", "wall", "--line0", unique("wire"), "--line0-rate-hz", "ask"]
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
    options = ["--address", address, "--scene", "wall", "--size", "2448x2048"]
    command = [sys.executable, "-m", "fake_camera", *options, "--switch", f"{tmp_path}/switch,1000,512"]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as camera,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream,
        GvcpClient(address) as client,
    ):
        assert camera.stdout is not None
        camera.stdout.readline()
        stream.bind(("127.0.0.1", 0))
        stream.settimeout(10)
        start = slots(Features("", 2448, 2048, lambda: 0))["AcquisitionStart"]
        assert client.write(CCP, 2, STREAM_PORT, stream.getsockname()[1], STREAM_ADDRESS, 0x7F000001, start, 1) == 0
        stream.recv(0x10000)
        camera.send_signal(signal.SIGTERM)
        _, errors = camera.communicate(timeout=10)
    assert (camera.returncode, errors) == (0, "")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--address localhost", "argument --address: 'localhost' is not an IPv4 address"),
        ("--usb3 --tcp 99999", "argument --tcp: '99999' is not a whole number from 1 to 65535"),
        ("--seed 18446744073709551616", "argument --seed: '18446744073709551616' is not a whole number from 0 to"),
        ("--lens-f-number 0", "argument --lens-f-number: '0' is not a number from 0.5 to 32"),
        ("--lens-f-number wide", "argument --lens-f-number: 'wide' is not a number from 0.5 to 32"),
        ("--ptp 65535", "argument --ptp: '65535' is not a whole number from 1 to 65534"),
        ("ptp-master --port none", "argument --port: 'none' is not a whole number from 1 to 65534"),
        ("--usb3 --tcp --ptp", "--ptp is for GigE Vision cameras: leave it out"),
        ("--seed -1", "argument --seed: '-1' is not a whole number from 0 to 18446744073709551615"),
        ("--seed many", "argument --seed: 'many' is not a whole number"),
    ],
)
def test_an_option_out_of_bounds_is_named(options: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(options.split())
    assert words in capsys.readouterr().err


@pytest.mark.wire
def test_a_ptp_master_says_when_it_is_ready_and_ends_cleanly() -> None:
    command = [sys.executable, "-m", "fake_camera", "ptp-master", "--port", "30319"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as master:
        assert master.stdout is not None
        ready = master.stdout.readline()
        assert ready == f"PTP master at 127.0.0.1, UDP ports 30319 and 30320, process {master.pid}\n"
        master.send_signal(signal.SIGUSR1)
        master.send_signal(signal.SIGTERM)
        _, errors = master.communicate(timeout=10)
    assert (master.returncode, errors) == (0, "")


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
