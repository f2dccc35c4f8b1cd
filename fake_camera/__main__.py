"""One fake camera as a process: ``python -m fake_camera --help``."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import gc
import signal
import sys
import threading
from pathlib import Path

from fake_camera.control_socket import ControlSocket
from fake_camera.device import Device
from fake_camera.exposure_wire import ExposureInput, ExposureOutput
from fake_camera.features import ENUM_ENTRIES, Features
from fake_camera.genapi.description import Description
from fake_camera.gige import AddressTakenError, GigeServer
from fake_camera.imaging import ImageSource
from fake_camera.lighting import LightScript
from fake_camera.line0 import Line0, WireError
from fake_camera.simulation import build_image_source
from fake_camera.truth import TruthFile
from fake_camera.xml_camera import XmlCamera


def _parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m fake_camera",
        description="A GigE Vision camera in software, which stock Aravis opens as a real one.",
    )
    add = parser.add_argument
    add("--address", default="127.0.0.1", help="loopback address of the camera (%(default)s)")
    add("--serial", default="FAKE-LEFT", help="its serial number (%(default)s)")
    add("--side", choices=["left", "right"], default="left", help="its place in the stereo rig (%(default)s)")
    add("--line0", metavar="NAME", help="trigger wire, shared with the cameras that name the same (none)")
    add("--line0-rate-hz", type=_rate, default=60.0, metavar="HZ", help="pulses per second of the wire (%(default)g)")
    add("--line1", type=Path, metavar="SOCKET", help="wire from the exposure output to another camera's Line3")
    add("--line3", type=Path, metavar="SOCKET", help="wire from another camera's Line1")
    add("--scene", default="room", metavar="room|FILE.hdr", help="what it sees (%(default)s)")
    add("--light", type=Path, metavar="FILE", help="light script (one with steps is built in)")
    add("--response", choices=["linear", "gamma", "s_shaped"], default="linear", help="of the sensor (%(default)s)")
    add("--seed", type=int, default=0, help="fixes room, noise and clock (%(default)s)")
    add("--xml", type=Path, metavar="FILE", help="wear this GenICam description of a real camera (none: its own)")
    add("--truth", type=Path, metavar="FILE", help="write the light at each pulse of the wire as JSON lines")
    add("--control", type=Path, metavar="SOCKET", help="Unix socket that takes faults as JSON lines")
    return parser.parse_args(arguments)


def _serial(text: str) -> str:
    if not 1 <= len(text.encode()) <= 15 or not text.isascii():
        raise argparse.ArgumentTypeError(f"{text!r} does not fit: GigE Vision has room for 15 ASCII characters")
    return text


def _rate(text: str) -> float:
    rate_hz = float(text)
    if not 1 <= rate_hz <= 1000:
        raise argparse.ArgumentTypeError(f"{text} Hz is not within 1 to 1000 Hz")
    return rate_hz


def _warm_up(source: ImageSource) -> None:
    """Render once in each pixel format: compilation and caches are not to delay the first frames."""
    features = Features("", source.sensor_width, source.sensor_height, lambda: 0)
    settings = features.image_settings(0)
    for pixel_format in ENUM_ENTRIES["PixelFormat"]:
        source.take(0.0, dataclasses.replace(settings, pixel_format=pixel_format), 0)
    source.lux(0.0)


def _run(options: argparse.Namespace, resources: contextlib.ExitStack) -> tuple[Device, XmlCamera | None]:
    """Start the camera; what `resources` holds must be closed to stop it."""
    light = LightScript.from_file(options.light) if options.light else LightScript.default()
    source = build_image_source(options.scene, options.side, light, options.seed, options.response)
    _warm_up(source)
    line0 = truth = None
    if options.line0 is not None:
        line0 = Line0.join(options.line0, options.line0_rate_hz)
        resources.callback(line0.close)
    if options.truth is not None:
        if line0 is None:
            raise WireError("--truth writes a line for each pulse of Line0: name the wire with --line0 NAME")
        truth = TruthFile(options.truth, source.lux, line0)
        resources.callback(truth.close)
    device = Device(source, options.serial, options.seed, line0, truth)
    resources.callback(device.close)
    if options.line1 is not None:
        output = ExposureOutput(options.line1)
        resources.callback(output.close)
        device.wire_line1(output.rise)
    if options.line3 is not None:
        resources.callback(ExposureInput(options.line3, device.line3_pulse).close)
    if options.control is not None:
        resources.callback(ControlSocket(options.control, device.faults).close)
    xml = None
    if options.xml is not None:
        xml = XmlCamera(Description.from_bytes(options.xml.read_bytes(), str(options.xml)), device)
    server = GigeServer(device, options.address, xml)
    server.start()
    resources.callback(server.close)
    return device, xml


def _worn(xml: XmlCamera | None) -> str:
    """What the camera passes for, and where that is less than the real one."""
    if xml is None:
        return ""
    who = f", as {xml.description.vendor} {xml.description.model}"
    line = f", trigger line {xml.trigger_line}" if xml.trigger_line else ", no trigger line"
    wire = " (a USB3 Vision camera, here over GigE Vision)" if xml.description.is_usb3 else ""
    closed = f", without {', '.join(xml.not_available)}" if xml.not_available else ""
    return who + wire + line + closed


def _sentence(error: Exception) -> str:
    """What went wrong, without the number of an operating system error."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def main(arguments: list[str] | None = None) -> int:
    """Run a camera until SIGTERM or SIGINT; returns the exit status: 0, or 2 with one sentence on stderr."""
    options = _parse_arguments(arguments)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    with contextlib.ExitStack() as resources:
        try:
            device, xml = _run(options, resources)
        except (AddressTakenError, OSError, ValueError, WireError) as error:
            print(f"fake camera {options.serial} at {options.address}: {_sentence(error)}", file=sys.stderr)
            return 2
        gc.collect()
        gc.freeze()  # a full collection over all that the compiler leaves behind takes 60 ms: four frames late
        wire = f"Line0 {options.line0} at {options.line0_rate_hz:g} Hz" if options.line0 else "no Line0"
        place = f"({options.side}) at {options.address}, {wire}, scene {options.scene}"
        print(f"fake camera {options.serial} {place}{_worn(xml)}", flush=True)
        stop.wait()
        print(device.counters, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
