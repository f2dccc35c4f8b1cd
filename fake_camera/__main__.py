"""One fake camera as a process: ``python -m fake_camera --help``; or a PTP master for fake cameras."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import gc
import ipaddress
import json
import signal
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path
from typing import get_args

from fake_camera.device.control_socket import ControlSocket
from fake_camera.device.device import Device
from fake_camera.device.exposure_wire import ExposureInput, ExposureOutput
from fake_camera.device.line0 import Line0, WireError
from fake_camera.device.truth import TruthFile
from fake_camera.files import read_regular
from fake_camera.genapi.description import Description
from fake_camera.genapi.raw_gain import RawGainLaw
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.gige.bootstrap import mac_address
from fake_camera.gige.server import AddressTakenError, GigeServer
from fake_camera.gige.switch import Switch
from fake_camera.imaging import PIXEL_FORMATS, ImageSource
from fake_camera.ptp import host_master
from fake_camera.ptp.messages import clock_identity
from fake_camera.ptp.port import EVENT_PORT
from fake_camera.usb3.run import ShimError, run, shim_path
from fake_camera.usb3.usbip.messages import TCP_PORT
from fake_camera.usb3.usbip.server import Usb3Server
from fake_camera.warm_up import Unpainted, frame_s, warm_up
from fake_camera.world.lighting import LightScript
from fake_camera.world.scene.kept_room import kept_room
from fake_camera.world.scene.room import furnished_room
from fake_camera.world.sensor import DEFAULT_F_NUMBER, SIZES
from fake_camera.world.simulation import build_image_source
from fake_camera.world.steered import Steered

_ADDRESS = "127.0.0.1"
_LONGEST_DESCRIPTION_BYTES = 1 << 24
_SERIAL_CHARACTERS = {"GigE Vision": 15, "USB3 Vision": 63}  # registers of 16 and 64 bytes, with a final zero
_SIZES = ", ".join(f"{width}x{height}" for width, height in SIZES)
_PTP = f"have a PTP clock, on this UDP port and the next ({EVENT_PORT}), and take action commands"
_ASK = "60; ask: print how long a frame takes, and read the rate from standard input"


def _parse_arguments(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m fake_camera",
        description="A GigE Vision or USB3 Vision camera in software, which stock Aravis opens like a real one.",
        epilog="python -m fake_camera ptp-master --help: a PTP master for cameras with --ptp.",
    )
    add = parser.add_argument
    add("--address", type=_address, help=f"loopback address of a GigE Vision camera ({_ADDRESS})")
    add("--usb3", action="store_true", help="be a USB3 Vision camera; needs --socket, --tcp or --exec")
    add("--socket", type=Path, metavar="PATH", help="Unix socket to serve USB/IP on")
    add("--tcp", type=_port, nargs="?", const=TCP_PORT, metavar="PORT", help="TCP port for it on 127.0.0.1 (%(const)d)")
    add("--exec", nargs=argparse.REMAINDER, metavar="COMMAND", help="run a command that sees the camera on its USB bus")
    add("--ptp", type=host_master.event_port, nargs="?", const=EVENT_PORT, metavar="PORT", help=_PTP)
    add("--switch", type=_switch, metavar="FILE,MBPS,KIB", help="send through a switch, shared by all that name FILE")
    add("--serial", default="FAKE-LEFT", help="its serial number (%(default)s)")
    add("--side", choices=["left", "right"], default="left", help="its side of the stereo rig (%(default)s)")
    add("--line0", metavar="NAME", help="trigger wire, shared by all cameras that name it (none)")
    add("--line0-rate-hz", type=_rate, default=60.0, metavar="HZ|ask", help=f"pulses per second of the wire ({_ASK})")
    add("--line1", type=Path, metavar="SOCKET", help="wire from the exposure output to another camera's Line3")
    add("--line3", type=Path, metavar="SOCKET", help="wire from another camera's Line1")
    add("--scene", default="room", metavar="room|board|wall|FILE.hdr", help="what the camera sees (%(default)s)")
    add("--pixel-format", choices=PIXEL_FORMATS, default="Mono8", metavar="NAME", help="at power-on (%(default)s)")
    add("--size", type=_size, default=SIZES[0], metavar="WxH", help=f"of its sensor: {_SIZES} (720x540)")
    add("--still", action="store_true", help="do not move, as on a tripod")
    add("--steered", action="store_true", help="move, and be lit, as orders on the control socket say")
    add("--light", type=Path, metavar="FILE", help="light script (150 and 1 lux in turn)")
    add("--lens-f-number", type=_f_number, default=DEFAULT_F_NUMBER, metavar="F", help="of its lens (%(default)s)")
    add("--corner-light", type=_corner_light, default=1.0, metavar="SHARE", help="light in its corners (%(default)s)")
    add("--response", choices=["linear", "gamma", "s_shaped"], default="linear", help="of the sensor (%(default)s)")
    add("--seed", type=_seed, default=0, help="determines room, noise and clock (%(default)s)")
    add("--nice", type=_niceness, default=0, metavar="N", help="niceness of the rendering, as of nice(1) (%(default)s)")
    add("--keep-room", type=Path, metavar="FOLDER", help="keep the painted room there (47 MB) for a faster start")
    add("--xml", type=Path, metavar="FILE", help="serve this GenICam description of a real camera (its own)")
    add("--raw-gain", choices=get_args(RawGainLaw), help="in what a raw gain of --xml is linear (decibels)")
    add("--truth", type=Path, metavar="FILE", help="write the light at each pulse of the wire as JSON lines")
    add("--control", type=Path, metavar="SOCKET", help="Unix socket that takes orders as JSON lines")
    options = parser.parse_args(arguments)
    _refuse_contradictions(parser, options)
    if not options.usb3:
        options.address = options.address or _ADDRESS
    return options


def _refuse_contradictions(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """End with one sentence where options do not go together."""
    usb3_options = [f"--{name}" for name in ("socket", "tcp", "exec") if getattr(options, name) is not None]
    if options.usb3 and options.address is not None:
        parser.error("--address is for GigE Vision cameras: leave out --address or --usb3")
    if options.usb3 and not usb3_options:
        parser.error("--usb3 needs a way to reach the camera: --socket PATH, --tcp or --exec COMMAND")
    if options.raw_gain is not None and options.xml is None:
        parser.error("--raw-gain needs --xml FILE: the camera's own gain is in dB")
    if options.line0_rate_hz is None and (options.line0 is None or options.xml is not None):
        parser.error("--line0-rate-hz ask needs --line0 NAME, and does not work with --xml")
    if options.steered and (options.control is None or options.line0 is None or options.scene != "room"):
        parser.error("--steered needs --control SOCKET and --line0 NAME, and the scene `room`")
    if options.steered and (options.still or options.light is not None):
        parser.error("--steered: orders say how the camera moves and how bright it is, leave out --still and --light")
    for name in ("switch", "ptp"):
        if options.usb3 and getattr(options, name) is not None:
            parser.error(f"--{name} is for GigE Vision cameras: leave it out")
    if not options.usb3 and usb3_options:
        parser.error(f"{usb3_options[0]} is for USB3 Vision cameras: add --usb3")
    if options.exec in ([], [""]):
        parser.error("--exec needs a command")
    if (wrong := _wrong_with_serial(options.serial, options.usb3)) is not None:
        parser.error(f"--serial {options.serial!r} {wrong}")


def _wrong_with_serial(serial: str, usb3: bool) -> str | None:
    """Why a serial number cannot be sent as it is; None when it can."""
    standard = "USB3 Vision" if usb3 else "GigE Vision"
    if not (serial.isascii() and serial.isprintable() and serial.strip() == serial != ""):
        return "is not a serial number: give ASCII characters without leading or trailing blanks"
    if len(serial) > _SERIAL_CHARACTERS[standard]:
        return f"is too long: {standard} allows {_SERIAL_CHARACTERS[standard]} characters"
    return None


def _address(text: str) -> str:
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not an IPv4 address: give one such as 127.0.0.2") from error


def _port(text: str) -> int:
    return _integer(text, 1, 0xFFFF)


def _seed(text: str) -> int:
    return _integer(text, 0, 2**64 - 1)


def _niceness(text: str) -> int:
    return _integer(text, 0, 19)


def _size(text: str) -> tuple[int, int]:
    size = next((size for size in SIZES if text == f"{size[0]}x{size[1]}"), None)
    if size is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size that can be simulated: {_SIZES}")
    return size


def _integer(text: str, low: int, high: int) -> int:
    try:
        number = int(text)
    except ValueError:
        number = low - 1
    if not low <= number <= high:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {low} to {high}")
    return number


def _switch(text: str) -> tuple[Path, float, int]:
    """File, megabits per second and bytes of a switch."""
    try:
        file, mbps, kib = text.rsplit(",", 2)
        speed, size = float(mbps), int(kib)
    except ValueError:
        file, speed, size = "", 0.0, 0
    if not (file and 1 <= speed <= 100_000 and 16 <= size <= 1 << 20):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no switch: give a file, 1 to 100000 Mb/s and 16 to 1048576 KiB, as in /tmp/switch,1000,128"
        )
    return Path(file), speed, size * 1024


def _f_number(text: str) -> float:
    return _number(text, 0.5, 32)


def _corner_light(text: str) -> float:
    return _number(text, 0.05, 1)


def _number(text: str, low: float, high: float) -> float:
    try:
        number = float(text)
    except ValueError:
        number = low - 1
    if not low <= number <= high:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from {low:g} to {high:g}")
    return number


def _rate(text: str) -> float | None:
    """A rate in Hz, or None for `ask`."""
    if text == "ask":
        return None
    rate_hz = float(text)
    if not 1 <= rate_hz <= 1000:
        raise argparse.ArgumentTypeError(f"{text} Hz is not between 1 and 1000 Hz")
    return rate_hz


def _run(options: argparse.Namespace, resources: contextlib.ExitStack) -> tuple[Device, XmlCamera | None]:
    """Start the camera; closing `resources` stops it."""
    light = LightScript.from_file(options.light) if options.light else LightScript.default()
    steered = Steered() if options.steered else None
    with contextlib.ExitStack() as meanwhile:
        if options.line0_rate_hz is None:
            _be_found(options, meanwhile)
        paint = partial(kept_room, folder=options.keep_room) if options.keep_room else furnished_room
        source = build_image_source(
            options.scene,
            options.side,
            light,
            options.seed,
            options.response,
            still=options.still,
            paint=paint,
            lens_f_number=options.lens_f_number,
            corner_light=options.corner_light,
            steered=steered,
            size=options.size,
        )
        warm_up(source, options.pixel_format)
        if options.line0_rate_hz is None:
            options.line0_rate_hz = _ask_for_rate(source, options.pixel_format)
    line0 = truth = None
    if options.line0 is not None:
        line0 = Line0.join(options.line0, options.line0_rate_hz)
        resources.callback(line0.close)
        if steered is not None:
            steered.epoch_ns = line0.epoch_ns
    if options.truth is not None:
        if line0 is None:
            raise WireError("--truth writes a line for each pulse of Line0: add --line0 NAME")
        truth = TruthFile(options.truth, source.lux, line0)
        resources.callback(truth.close)
    device = _device(options, source, line0, truth)
    resources.callback(device.close)
    if options.line1 is not None:
        output = ExposureOutput(options.line1)
        resources.callback(output.close)
        device.wire_line1(output.rise)
    if options.line3 is not None:
        resources.callback(ExposureInput(options.line3, device.line3_pulse).close)
    if options.control is not None:
        resources.callback(ControlSocket(options.control, device.faults, steered).close)
    xml = None
    if options.xml is not None:
        xml = XmlCamera(_description(options.xml, options.usb3), device, options.raw_gain or "decibels")
    _serve(options, device, xml, resources)
    return device, xml


def _device(
    options: argparse.Namespace, source: ImageSource, line0: Line0 | None = None, truth: TruthFile | None = None
) -> Device:
    model = "FakeU3V287M" if options.usb3 else "FakeGV287M"
    return Device(
        source,
        options.serial,
        options.seed,
        line0,
        truth,
        model=model,
        pixel_format=options.pixel_format,
        niceness=options.nice,
        ptp_clock=None if options.ptp is None else clock_identity(mac_address(options.serial)),
    )


def _serve(options: argparse.Namespace, device: Device, xml: XmlCamera | None, resources: contextlib.ExitStack) -> None:
    """Serve the camera until `resources` are closed."""
    if options.usb3:
        resources.callback(Usb3Server(device, options.socket, options.tcp, xml).close)
    else:
        switch = None
        if options.switch is not None:
            switch = resources.enter_context(Switch(*options.switch))
        server = GigeServer(device, options.address, xml, switch, ptp_event_port=options.ptp or EVENT_PORT)
        server.start()
        resources.callback(server.close)


def _be_found(options: argparse.Namespace, meanwhile: contextlib.ExitStack) -> None:
    """Answer searches, which take a second, already while the room is being painted."""
    device = _device(options, Unpainted(options.size))
    meanwhile.callback(device.close)
    _serve(options, device, None, meanwhile)
    print(json.dumps({"can_be_found": True}), flush=True)


def _ask_for_rate(source: ImageSource, pixel_format: str) -> float:
    """Print how long a frame takes, and wait for the rate of the wire; raises ValueError when none comes."""
    print(json.dumps({"frame_s": round(frame_s(source, pixel_format), 6)}), flush=True)
    answer = sys.stdin.readline().strip()
    try:
        rate_hz = _rate(answer)
    except (ValueError, argparse.ArgumentTypeError):
        rate_hz = None
    if rate_hz is None:
        raise ValueError(f"standard input gave {answer!r} as the rate of the wire: give a number of Hz")
    return rate_hz


def _description(path: Path, usb3: bool) -> Description:
    """The description in a file; ValueError when it is not one, or describes a camera on the other transport."""
    description = Description.from_bytes(read_regular(path, _LONGEST_DESCRIPTION_BYTES), str(path))
    if description.standard == "U3V" and not usb3:
        raise ValueError(f"{path} describes a USB3 Vision camera: add --usb3 and --exec, --socket or --tcp")
    if description.standard == "GEV" and usb3:
        raise ValueError(f"{path} describes a GigE Vision camera: leave out --usb3 and its options")
    return description


def _worn(xml: XmlCamera | None) -> str:
    """Which real camera it imitates, and what it lacks of that one."""
    if xml is None:
        return ""
    who = f", as {xml.description.vendor} {xml.description.model}"
    line = f", trigger line {xml.trigger_line}" if xml.trigger_line else ", no trigger line"
    closed = f", without {', '.join(xml.not_available)}" if xml.not_available else ""
    return who + line + closed


def _sentence(error: Exception) -> str:
    """What went wrong, without the errno of an operating system error."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def stopped_by_signals() -> threading.Event:
    """Set at SIGTERM and SIGINT; on another thread, as the interrupted one may be holding its lock."""
    stop = threading.Event()

    def end(*_: object) -> None:
        if not stop.is_set():  # else this process may be ending, and begins no thread
            threading.Thread(target=stop.set).start()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    return stop


def main(arguments: list[str] | None = None) -> int:
    """Run a camera until SIGTERM or SIGINT, or until the command of --exec ends.

    Returns the exit status: 0 or that of the command, or 2 with one sentence on stderr.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["ptp-master"]:
        return host_master.main(arguments[1:])
    options = _parse_arguments(arguments)
    stop = stopped_by_signals()
    where = "on USB" if options.usb3 else f"at {options.address}"
    notes = sys.stderr if options.exec else sys.stdout  # the command's output is its own
    with contextlib.ExitStack() as resources:
        try:
            if options.exec:
                shim_path()  # fail now rather than when the camera is ready
            if options.usb3 and options.socket is None:
                options.socket = Path(resources.enter_context(tempfile.TemporaryDirectory())) / "camera"
            device, xml = _run(options, resources)
            gc.collect()
            gc.freeze()  # a full collection over what the compiler leaves behind takes 60 ms: four frames late
            wire = f"Line0 {options.line0} at {options.line0_rate_hz:g} Hz" if options.line0 else "no Line0"
            name = f"fake camera {options.serial} ({options.side})"
            print(f"{name} {where}, {wire}, scene {options.scene}{_worn(xml)}", file=notes, flush=True)
            status, begun_s = 0, time.process_time()
            if options.exec:
                status = run(options.exec, [options.socket], stop)
            stop.wait()
        except (AddressTakenError, OSError, ShimError, ValueError, WireError) as error:
            print(f"fake camera {options.serial} {where}: {_sentence(error)}", file=sys.stderr)
            return 2
        end = dataclasses.asdict(device.counters) | {"cpu_s": round(time.process_time() - begun_s, 6)}
        print(json.dumps(end), file=notes, flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
