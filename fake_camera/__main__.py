"""One fake camera as a process: ``python -m fake_camera --help``; or a PTP master for fake cameras."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import gc
import json
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path

from fake_camera.device.control_socket import ControlSocket
from fake_camera.device.device import Device
from fake_camera.device.exposure_wire import ExposureInput, ExposureOutput
from fake_camera.device.line0 import Line0, WireError
from fake_camera.device.truth import TruthFile
from fake_camera.files import read_regular
from fake_camera.genapi.description import Description
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.gige.bootstrap import mac_address
from fake_camera.gige.server import AddressTakenError, GigeServer
from fake_camera.gige.switch import Switch
from fake_camera.imaging import ImageSource
from fake_camera.options import parse_arguments, rate_of
from fake_camera.ptp import host_master
from fake_camera.ptp.messages import clock_identity
from fake_camera.ptp.port import EVENT_PORT
from fake_camera.signals import stopped_by_signals, wait_for, wait_for_input
from fake_camera.usb3.run import ShimError, run, shim_path
from fake_camera.usb3.usbip.server import Usb3Server
from fake_camera.warm_up import Unpainted, frame_s, warm_up
from fake_camera.world.lighting import LightScript
from fake_camera.world.scene.kept_room import kept_room
from fake_camera.world.scene.room import furnished_room
from fake_camera.world.simulation import build_image_source
from fake_camera.world.steered import Steered

_LONGEST_DESCRIPTION_BYTES = 1 << 24


class _StoppedError(Exception):
    """A signal came before the camera was ready."""


def _run(
    options: argparse.Namespace, resources: contextlib.ExitStack, stop: threading.Event
) -> tuple[Device, XmlCamera | None]:
    """Start the camera; closing `resources` stops it."""
    light = LightScript.from_file(options.light) if options.light else LightScript.default()
    steered = Steered() if options.steered else None
    with contextlib.ExitStack() as meanwhile:
        if options.line0_rate_hz is None:
            _be_found(options, meanwhile)
        paint = partial(kept_room, folder=options.keep_room) if options.keep_room else furnished_room
        if steered is not None:
            paint = partial(paint, cleared=True)
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
            yaw_deg=options.yaw_deg,
            sunlit_stops=options.sunlit_stops,
        )
        warm_up(source, options.pixel_format)
        if options.line0_rate_hz is None:
            options.line0_rate_hz = _ask_for_rate(source, options.pixel_format, stop)
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
    switch = _switch(options, resources)
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
    _serve(options, device, xml, switch, resources)
    return device, xml


def _switch(options: argparse.Namespace, resources: contextlib.ExitStack) -> Switch | None:
    """The switch, if there is one; to be opened before the device, which sends through it until it is closed."""
    return None if options.switch is None else resources.enter_context(Switch(*options.switch))


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


def _serve(
    options: argparse.Namespace,
    device: Device,
    xml: XmlCamera | None,
    switch: Switch | None,
    resources: contextlib.ExitStack,
) -> None:
    """Serve the camera until `resources` are closed."""
    if options.usb3:
        resources.callback(Usb3Server(device, options.socket, options.tcp, xml).close)
    else:
        ptp, second = options.ptp or EVENT_PORT, options.second_address
        server = GigeServer(device, options.address, xml, switch, ptp_event_port=ptp, second_address=second)
        server.start()
        resources.callback(server.close)


def _be_found(options: argparse.Namespace, meanwhile: contextlib.ExitStack) -> None:
    """Answer searches, which take a second, already while the room is being painted."""
    switch = _switch(options, meanwhile)
    device = _device(options, Unpainted(options.size))
    meanwhile.callback(device.close)
    _serve(options, device, None, switch, meanwhile)
    print(json.dumps({"can_be_found": True}), flush=True)


def _ask_for_rate(source: ImageSource, pixel_format: str, stop: threading.Event) -> float:
    """Print how long a frame takes, and wait for the rate of the wire; raises ValueError when none comes."""
    print(json.dumps({"frame_s": round(frame_s(source, pixel_format), 6)}), flush=True)
    if not wait_for_input(sys.stdin, stop):
        raise _StoppedError
    answer = sys.stdin.readline().strip()
    try:
        rate_hz = rate_of(answer)
    except argparse.ArgumentTypeError:
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


def main(arguments: list[str] | None = None) -> int:
    """Run a camera until SIGTERM or SIGINT, or until the command of --exec ends.

    Returns the exit status: 0 or that of the command, or 2 with one sentence on stderr.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["ptp-master"]:
        return host_master.main(arguments[1:])
    options = parse_arguments(arguments)
    stop = stopped_by_signals()
    where = "on USB" if options.usb3 else f"at {options.address}"
    notes = sys.stderr if options.exec else sys.stdout  # the command's output is its own
    with contextlib.ExitStack() as resources:
        try:
            if options.exec:
                shim_path()  # fail now rather than when the camera is ready
            if options.usb3 and options.socket is None:
                options.socket = Path(resources.enter_context(tempfile.TemporaryDirectory())) / "camera"
            device, xml = _run(options, resources, stop)
            gc.collect()
            gc.freeze()  # a full collection over what the compiler leaves behind takes 60 ms: four frames late
            wire = f"Line0 {options.line0} at {options.line0_rate_hz:g} Hz" if options.line0 else "no Line0"
            name = f"fake camera {options.serial} ({options.place})"
            print(f"{name} {where}, {wire}, scene {options.scene}{_worn(xml)}", file=notes, flush=True)
            status, begun_s = 0, time.process_time()
            if options.exec:
                status = run(options.exec, [options.socket], stop)
            wait_for(stop)
        except _StoppedError:
            return 0
        except (AddressTakenError, OSError, ShimError, ValueError, WireError) as error:
            print(f"fake camera {options.serial} {where}: {_sentence(error)}", file=sys.stderr)
            return 2
        end = dataclasses.asdict(device.counters) | {"cpu_s": round(time.process_time() - begun_s, 6)}
        print(json.dumps(end), file=notes, flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
