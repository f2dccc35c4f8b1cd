"""Stock libusb and stock Aravis meet the USB3 Vision fake, in processes under the shim."""

from __future__ import annotations

import ctypes.util
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from fake_camera.usb3.run import CAMERAS_VARIABLE, ShimError, client_environment
from tests.fakes import FakeCamera, run_camera, run_under_shim, usb3_camera, usb3_environment

pytestmark = pytest.mark.wire

SUITE = Path(__file__).parent / "shim_suite.py"
LEFT_TO_LIBUDEV = {"udev_new", "udev_unref"}

needs_arv_tool = pytest.mark.needs("arv-tool-0.8")
needs_lsusb = pytest.mark.needs("lsusb")
needs_gcc = pytest.mark.needs("gcc", "nm")


@pytest.fixture(scope="module")
def fake() -> Iterator[FakeCamera]:
    with usb3_camera() as camera:
        yield camera


def output(environment: Mapping[str, str], *command: str) -> str:
    """What a command prints; it must print nothing on standard error."""
    process = subprocess.run(
        command, env=environment, capture_output=True, text=True, errors="replace", timeout=30, check=False
    )
    assert (process.returncode, process.stderr) == (0, ""), process.stdout
    return process.stdout


@pytest.mark.wire
def test_aravis_under_the_shim(tmp_path: Path) -> None:
    run_under_shim(SUITE, tmp_path / "left", tmp_path / "right")


@needs_arv_tool
def test_arv_tool_lists_reads_and_writes(fake: FakeCamera) -> None:
    with usb3_camera() as other:
        listed = output(usb3_environment(fake.socket, other.socket), "arv-tool-0.8")
    for camera in (fake, other):
        assert re.search(rf"^Autoexpose-[0-9A-F]{{12}}-{camera.serial} \(USB3\)$", listed, re.MULTILINE)
    answer = output(
        usb3_environment(fake.socket),
        *("arv-tool-0.8", "-n", f"Autoexpose-{fake.serial}"),
        *("control", "ExposureAuto=Off", "ExposureTime=4321", "Width"),
    )
    assert "ExposureTime = 4321 us" in answer
    assert "Width = 720 px" in answer


@needs_arv_tool
def test_a_killed_camera_is_gone_and_its_place_can_be_taken(tmp_path: Path) -> None:
    environment = usb3_environment(tmp_path / "camera")
    with usb3_camera(socket=tmp_path / "camera") as camera:
        assert camera.serial in output(environment, "arv-tool-0.8")
        camera.kill()
        listing = subprocess.run(
            ["arv-tool-0.8"], env=environment, capture_output=True, text=True, errors="replace", check=False
        )
        assert camera.serial not in listing.stdout
    with usb3_camera(socket=tmp_path / "camera") as camera:
        assert camera.serial in output(environment, "arv-tool-0.8")


@needs_lsusb
def test_lsusb_lists_the_camera(fake: FakeCamera) -> None:
    environment = usb3_environment(fake.socket)
    # The short list takes its names from the database of USB numbers, where there is one.
    assert output(environment, "lsusb").startswith("Bus 100 Device 002: ID 1209:0001 ")
    details = output(environment, "lsusb", "-v")
    for text in ("Autoexpose", "FakeU3V287M", fake.serial):
        assert text in details


@needs_arv_tool
def test_exec_runs_a_command_that_sees_the_cameras() -> None:
    inner = [sys.executable, "-m", "fake_camera", "--usb3", "--serial", "INNER", "--exec", "arv-tool-0.8"]
    process = run_camera("--usb3", "--serial", "OUTER", "--exec", *inner)
    assert process.returncode == 0
    assert re.search(r"^Autoexpose-[0-9A-F]{12}-OUTER \(USB3\)$", process.stdout, re.MULTILINE)
    assert re.search(r"^Autoexpose-[0-9A-F]{12}-INNER \(USB3\)$", process.stdout, re.MULTILINE)


def test_exec_ends_as_the_command_does() -> None:
    assert run_camera("--usb3", "--exec", "sh", "-c", "exit 3").returncode == 3
    process = run_camera("--usb3", "--exec", "no-such-command")
    assert process.returncode == 2
    assert process.stderr.endswith("fake camera FAKE-LEFT on USB: no-such-command: No such file or directory\n")


def test_the_environment_keeps_what_was_preloaded_and_the_cameras_there_were() -> None:
    before = {"LD_PRELOAD": "libother.so", CAMERAS_VARIABLE: "/tmp/a"}
    after = client_environment([Path("/tmp/b")], before)
    again = client_environment([], after)
    assert after[CAMERAS_VARIABLE] == "/tmp/a:/tmp/b"
    assert after["LD_PRELOAD"].endswith(":libother.so")
    assert again == after
    with pytest.raises(ShimError, match="cannot be passed"):
        client_environment([Path("/tmp/a:b")], before)


@needs_gcc
def test_the_shim_has_what_the_installed_libusb_asks_of_udev() -> None:
    library = ctypes.util.find_library("usb-1.0")
    assert library is not None, "libusb is not installed; `make setup` installs it"
    path = next(Path(folder) / library for folder in library_folders() if (Path(folder) / library).exists())
    needed = udev_symbols("--undefined-only", path)
    preloaded = Path(usb3_environment()["LD_PRELOAD"].split(":", maxsplit=1)[0])
    assert needed
    assert needed - LEFT_TO_LIBUDEV <= udev_symbols("--defined-only", preloaded)


def library_folders() -> list[str]:
    return [f"/usr/lib/{os.uname().machine}-linux-gnu", "/usr/lib64", "/usr/lib"]


def udev_symbols(which: str, library: Path) -> set[str]:
    listed = output(os.environ, "nm", "-D", which, str(library))
    return {name.split("@")[0] for name in re.findall(r"\b(udev_\S+)", listed)}


@needs_gcc
def test_a_libusb_that_needs_more_of_udev_is_refused_by_name(tmp_path: Path) -> None:
    source, program = tmp_path / "other.c", tmp_path / "other"
    source.write_text(
        "void *udev_enumerate_new(void *); void *udev_device_get_parent(void *);\n"
        "int main(void) { udev_enumerate_new(0); return udev_device_get_parent(0) != 0; }\n"
    )
    output(os.environ, "gcc", str(source), "-l:libudev.so.1", "-o", str(program))
    process = subprocess.run([program], env=usb3_environment(), capture_output=True, text=True, check=False)
    missing = f"{program} needs udev_device_get_parent, which is missing: add it to udev.c"
    assert (process.returncode, process.stderr) == (1, f"fake USB bus: {missing}\n")
