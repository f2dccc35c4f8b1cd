"""The daemon on fake cameras, and its results: the part of the demo that loads while they start."""

from __future__ import annotations

import gc
import json
import os
import signal
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from rich.console import Console

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.demo.analysis import DemoRun, StepLog, figures, in_words, light_steps, pulses_in_window
from autoexpose_daemon.demo.fakes import FakeCameras, newest_lux, places, read_pulses
from autoexpose_daemon.demo.options import DemoOptions
from autoexpose_daemon.demo.reference_step import reference_step_ms
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.setup import openers
from autoexpose_daemon.service.logs import set_up_logging
from autoexpose_daemon.service.service import Service, add_outlets
from autoexpose_daemon.status.panel import display
from calibration.geometry.opencv import ros_yaml
from drivers.aravis import find_cameras
from imaging.errors import AutoexposeError
from imaging.frames import CameraName
from imaging.geometry import SIDES, CameraGeometry
from imaging.pixels import PIXEL_FORMATS

if TYPE_CHECKING:
    from autoexpose_daemon.recording.recorder import GroupRecorders, Recorder

SENSOR = {"full_well_e": 22_000.0, "read_noise_e": 3.0}
"""As `autoexpose calibrate noise` finds them."""

_FOCAL_WIDTHS = 860 / 720
_BASELINE_M = 0.08


def geometry_files(width_height: tuple[int, int], folder: Path) -> dict[CameraName, dict[str, str]]:
    """Write the geometry of a stereo pair; returns the keys for the configuration."""
    width, height = width_height
    focal_px, x, y = _FOCAL_WIDTHS * width, (width - 1) / 2, (height - 1) / 2
    k = (focal_px, 0.0, x, 0.0, focal_px, y, 0.0, 0.0, 1.0)
    unturned = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    keys: dict[CameraName, dict[str, str]] = {}
    for camera in SIDES:
        shift = -focal_px * _BASELINE_M if camera == "right" else 0.0
        p = (focal_px, 0.0, x, shift, 0.0, focal_px, y, 0.0, 0.0, 0.0, 1.0, 0.0)
        geometry = CameraGeometry(width, height, "plumb_bob", (0.0,) * 5, k, unturned, p)
        file = folder / f"{camera}.yaml"
        file.write_text(ros_yaml(geometry, camera), encoding="ascii")
        keys[camera] = {"calibration": str(file)}
    return keys


RATES_HZ = (60.0, 30.0, 20.0, 10.0, 4.0, 2.0)
"""The demo runs at the highest that this machine can sustain.

Not at 5 Hz: over USB3 Vision Aravis 0.8.26 waits 0.2 s at a time for a frame, and may lose one that arrives between
two waits (docs/do/usb3.md).
"""

_USABLE_SHARE = 0.85  # of the cores; the rest is for the terminal and the system
_SENDING_S = 0.001  # a fake camera's time per frame apart from rendering: packets, clock, commands
_DAEMON_S = 0.00425  # the daemon's time for a frame: half a core for 60 pairs a second, as measured on a slow machine
_MEASURED_AT_BYTES = 720 * 540
_QUOTA = Path("/sys/fs/cgroup/cpu.max")


def cores(quota: Path = _QUOTA) -> float:
    """How many cores this process may use, by its affinity and its container's quota (cgroup v2)."""
    allowed = len(os.sched_getaffinity(0))
    try:
        share, period = quota.read_text().split()
        return allowed if share == "max" else min(allowed, int(share) / int(period))
    except (OSError, ValueError, ZeroDivisionError):
        return allowed


def sets_per_s(frame_s: float, cores: float, image_bytes: int = _MEASURED_AT_BYTES, cameras: int = 2) -> float:
    """Sets per second that so many fake cameras, which need `frame_s` per frame, can make beside the daemon.

    The time that sending and the daemon take is assumed to grow with a frame's `image_bytes`.
    """
    size = image_bytes / _MEASURED_AT_BYTES
    camera_s = frame_s + size * _SENDING_S
    return _USABLE_SHARE * min(cores / cameras / (camera_s + size * _DAEMON_S), 1 / camera_s)


def held_rate_hz(possible_hz: float) -> float:
    """The highest rate that can be sustained, or the lowest of all."""
    return next((rate_hz for rate_hz in RATES_HZ if rate_hz <= possible_hz), RATES_HZ[-1])


def rate_notice(possible_hz: float, rate_hz: float, asked: bool) -> str | None:
    """What to say before the first frame if the machine is too slow, else None."""
    renders = f"this machine renders {possible_hz:.0f} frames a second"
    if rate_hz > possible_hz:
        return f"{renders}: at {rate_hz:g} Hz the fake cameras will lose some"
    return f"{renders}: showing {rate_hz:g} Hz" if not asked and rate_hz < RATES_HZ[0] else None


_LONGEST_US = 7500.0
_PICTURES = 80
REFERENCE_REPEATS = 60
_SEARCH_HOLDS_S = 1.2  # less than the daemon's two seconds: the cameras still have to get ready


def show(options: DemoOptions, cameras: FakeCameras, stop: threading.Event, console: Console) -> DemoRun:
    """Run the daemon on cameras that are starting, then end them."""
    rate_hz = start(cameras, options, console)
    step_log = StepLog(options.seconds / _PICTURES, options.cameras)
    with ExitStack() as resources:
        calibrations: Mapping[CameraName, Mapping[str, str]] = {}
        if options.bracket:
            folder = resources.enter_context(tempfile.TemporaryDirectory(prefix="autoexpose-rig-"))
            calibrations = geometry_files(options.width_height, Path(folder))
        config = configuration(options, rate_hz, calibrations)
        recorder = _recorder(options, config)
        if recorder is not None:
            resources.enter_context(recorder)
        service = Service(
            config,
            lambda config, start: add_outlets(Daemon(config, openers(config), start, [step_log]), config, recorder),
        )
        took_s, cpu_s = _run_for(options.seconds, service, stop, console, cameras.truths[0])
    cameras.end()
    if recorder is not None:
        console.print(recorder.summary)
    pulses = pulses_in_window(read_pulses(cameras.truths), service.daemon.tally)
    reference_ms = reference_step_ms(REFERENCE_REPEATS)
    return DemoRun(options, rate_hz, service.daemon, cameras.all, pulses, step_log, took_s, took_s, cpu_s, reference_ms)


def report(run: DemoRun, console: Console) -> None:
    """Print, write and draw the results of a run.

    Raises AutoexposeError when the daemon's account of triggers disagrees with the wire's.
    """
    options = run.options
    # A bracket settles nowhere.
    steps = [] if options.bracket else light_steps(run.pulses, run.step_log.steps)
    result = figures(run, steps)
    console.print(in_words(result, steps))
    if options.summary is not None:
        options.summary.write_text(json.dumps(result, indent=2) + "\n")
    if options.plot is not None:
        from autoexpose_daemon.demo.plot import draw  # noqa: PLC0415  matplotlib takes a second to load

        draw(options.plot, run, steps)
        console.print(f"picture of the run: {options.plot}")
    if options.bracket:
        console.print(f"next: autoexpose rejudge {options.record}", highlight=False)
    check_account(result)


def check_account(result: dict[str, Any]) -> None:
    """Raise an AutoexposeError when the daemon's account of triggers disagrees with the wire's."""
    accounted = result["pairs"] + sum(result["lost"].values())
    if result["triggers"] != accounted:
        raise AutoexposeError(
            f"the account does not balance: {result['triggers']} triggers on the wire, "
            f"{result['pairs']} pairs and {accounted - result['pairs']} losses accounted for"
        )


def start(cameras: FakeCameras, options: DemoOptions, console: Console, highest_hz: float = RATES_HZ[0]) -> float:
    """Have the cameras run at the requested rate, or else at one that this machine sustains; returns the rate.

    The search runs while they get ready, and the daemon uses its result: otherwise the trigger wire would run for the
    second that a search takes.
    """
    cameras.wait_until_found()
    _search()
    if not cameras.are_timed(_SEARCH_HOLDS_S):
        console.print("preparing the simulation (the first start compiles it, which takes about 20 s) ...")
        _search()
    while not (cameras.are_timed(_SEARCH_HOLDS_S) or cameras.stop.is_set()):
        _search()
    image_bytes = PIXEL_FORMATS[options.pixel_format].image_bytes(*options.width_height)
    possible_hz = sets_per_s(cameras.frame_s(), cores(), image_bytes, options.cameras)
    rate_hz = options.rate_hz or min(held_rate_hz(possible_hz), highest_hz)
    words = rate_notice(possible_hz, rate_hz, asked=rate_hz == (options.rate_hz or highest_hz))
    if words is not None:
        console.print(words)
    cameras.run_at(rate_hz)
    return rate_hz


def _search() -> None:
    """Search for cameras; Ctrl-C waits for the end, because Aravis complains if its search is interrupted."""
    signals = {signal.SIGINT, signal.SIGTERM}
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    find_cameras()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, signals)


def configuration(
    options: DemoOptions, rate_hz: float, calibrations: Mapping[CameraName, Mapping[str, str]] = MappingProxyType({})
) -> Config:
    """The configuration of the daemon on the demo's cameras, each with the keys of its calibration."""
    control = {"policy": options.policy, **({"bracket": {}, **SENSOR} if options.bracket else {})}
    return Config.model_validate(
        {
            "cameras": {
                place.name: {"serial": place.serial, **place.group, **calibrations.get(place.name, {})}
                for place in places(options.cameras)
            },
            "trigger": {"mode": "external", "line": "Line0", "rate_hz": rate_hz},
            "exposure": {"max_time_us": min(_LONGEST_US, 0.8e6 / rate_hz)},
            "control": control,
            "image": {"pixel_format": options.pixel_format},
            "publish": {} if options.publish else None,
        }
    )


def _recorder(options: DemoOptions, config: Config) -> Recorder | GroupRecorders | None:
    if options.record is None:
        return None
    from autoexpose_daemon.recording.recorder import new_recorder  # noqa: PLC0415

    return new_recorder(options.record, config, None)


def _run_for(
    seconds: float, service: Service, stop: threading.Event, console: Console, truth: Path
) -> tuple[float, float]:
    """Run the daemon for some time; returns the elapsed time, and this process' CPU time in it (s)."""

    def title() -> str:
        lux = newest_lux(truth)
        return "autoexpose demo" if lux is None else f"autoexpose demo, light of {lux:g} lux"

    set_up_logging(console)
    gc.freeze()
    timer = threading.Timer(seconds, stop.set)
    timer.start()
    started_s, cpu_s = time.monotonic(), time.process_time()
    try:
        with display(console, title) as show:
            service.run(stop, show)
    finally:
        timer.cancel()
    return time.monotonic() - started_s, time.process_time() - cpu_s
