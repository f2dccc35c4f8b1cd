"""The options of ``python -m fake_camera``."""

from __future__ import annotations

import argparse
import ipaddress
from dataclasses import fields
from pathlib import Path
from typing import TypeVar, get_args

from fake_camera.genapi.raw_gain import RawGainLaw
from fake_camera.imaging import PIXEL_FORMATS
from fake_camera.places import PLACES, Place
from fake_camera.ptp import host_master
from fake_camera.ptp.port import EVENT_PORT
from fake_camera.usb3.usbip.messages import TCP_PORT
from fake_camera.world.sensor import DEFAULT_F_NUMBER, SIZES

Number = TypeVar("Number", int, float)

_ADDRESS = "127.0.0.1"
_SERIAL_CHARACTERS = {"GigE Vision": 15, "USB3 Vision": 63}  # registers of 16 and 64 bytes, with a final zero
_SIZES = ", ".join(f"{width}x{height}" for width, height in SIZES)
_PTP = f"have a PTP clock, on this UDP port and the next ({EVENT_PORT}), and take action commands"
_OF_A_PLACE = [field.name for field in fields(Place)]
_ASK = "60; ask: print how long a frame takes, and read the rate from standard input"


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """The options; ends the process with one sentence where one of them is wrong, or two contradict each other."""
    parser = argparse.ArgumentParser(
        prog="python -m fake_camera",
        description="A GigE Vision or USB3 Vision camera in software, which stock Aravis opens like a real one.",
        epilog="python -m fake_camera ptp-master --help: a PTP master for cameras with --ptp.",
    )
    add = parser.add_argument
    add("--address", type=_address, help=f"loopback address of a GigE Vision camera ({_ADDRESS})")
    add("--second-address", type=_address, metavar="ADDRESS", help="of a second network interface, for its stream")
    add("--usb3", action="store_true", help="be a USB3 Vision camera; needs --socket, --tcp or --exec")
    add("--socket", type=Path, metavar="PATH", help="Unix socket to serve USB/IP on")
    add("--tcp", type=_port, nargs="?", const=TCP_PORT, metavar="PORT", help="TCP port for it on 127.0.0.1 (%(const)d)")
    add("--exec", nargs=argparse.REMAINDER, metavar="COMMAND", help="run a command that sees the camera on its USB bus")
    add("--ptp", type=host_master.event_port, nargs="?", const=EVENT_PORT, metavar="PORT", help=_PTP)
    add("--switch", type=_switch, metavar="FILE,MBPS,KIB", help="send through a switch, shared by all that name FILE")
    add("--serial", default="FAKE-LEFT", help="its serial number (%(default)s)")
    add("--place", choices=PLACES, metavar="NAME", help=f"on a rig, in place of the next three: {', '.join(PLACES)}")
    add("--side", choices=["left", "right"], help="its side of the stereo pair (left)")
    add("--yaw-deg", type=_yaw, metavar="DEG", help="how far its pair is turned right (0)")
    add("--sunlit-stops", type=_sun, metavar="N", help="more light on what it sees (0)")
    add("--line0", metavar="NAME", help="trigger wire, shared by all cameras that name it (none)")
    add(
        "--line0-rate-hz",
        type=rate_of,
        default=60.0,
        metavar="HZ|ask",
        help=f"pulses per second of the wire ({_ASK})",
    )
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
    _place(parser, options)
    _refuse_contradictions(parser, options)
    if not options.usb3:
        options.address = options.address or _ADDRESS
    return options


def _place(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Fill in side, yaw and sun: those given, or those of the place."""
    given = {name: value for name in _OF_A_PLACE if (value := getattr(options, name)) is not None}
    if options.place is not None and given:
        parser.error(f"--place says where the camera is: leave out --{next(iter(given)).replace('_', '-')}")
    options.place = options.place or options.side or "left"
    for name in _OF_A_PLACE:
        setattr(options, name, given.get(name, getattr(PLACES[options.place], name)))


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
    if (options.yaw_deg or options.sunlit_stops) and options.scene != "room":
        parser.error("--yaw-deg, --sunlit-stops and places but left and right are for the scene `room`: leave them out")
    for name in ("switch", "ptp", "second_address"):
        if options.usb3 and getattr(options, name) is not None:
            parser.error(f"--{name.replace('_', '-')} is for GigE Vision cameras: leave it out")
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
    return _number(text, int, 1, 0xFFFF)


def _seed(text: str) -> int:
    return _number(text, int, 0, 2**64 - 1)


def _niceness(text: str) -> int:
    return _number(text, int, 0, 19)


def _size(text: str) -> tuple[int, int]:
    size = next((size for size in SIZES if text == f"{size[0]}x{size[1]}"), None)
    if size is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size that can be simulated: {_SIZES}")
    return size


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
    return _number(text, float, 0.5, 32)


def _yaw(text: str) -> float:
    return _number(text, float, -360, 360)


def _sun(text: str) -> float:
    return _number(text, float, 0, 10)


def _corner_light(text: str) -> float:
    return _number(text, float, 0.05, 1)


def _number(text: str, kind: type[Number], low: Number, high: Number) -> Number:
    """A whole number or any number, within bounds."""
    number: Number | None
    try:
        number = kind(text)
    except ValueError:
        number = None
    if number is None or not low <= number <= high:
        what = "a whole number" if kind is int else "a number"
        raise argparse.ArgumentTypeError(f"{text!r} is not {what} from {low} to {high}")
    return number


def rate_of(text: str) -> float | None:
    """A rate in Hz, or None for `ask`; ArgumentTypeError for anything else."""
    return None if text == "ask" else _number(text, float, 1, 1000)
