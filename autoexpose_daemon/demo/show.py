"""The daemon on two fake cameras, and its results: the part of the demo that loads while they start."""

from __future__ import annotations

import gc
import json
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
from autoexpose_daemon.demo.analysis import light_steps, pulses_in_window
from autoexpose_daemon.demo.brackets import SENSOR, geometry_files
from autoexpose_daemon.demo.fakes import SERIALS, FakeCameras, newest_lux, read_pulses
from autoexpose_daemon.demo.options import DemoOptions
from autoexpose_daemon.demo.rate import RATES_HZ, cores, held_rate_hz, pairs_per_s, shortfall
from autoexpose_daemon.demo.reference_step import reference_step_ms
from autoexpose_daemon.demo.step_log import StepLog
from autoexpose_daemon.demo.summary import Run, figures, in_words
from autoexpose_daemon.runtime.cameras import openers
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.service.logs import set_up_logging
from autoexpose_daemon.service.outlets import add_outlets
from autoexpose_daemon.service.service import Service
from autoexpose_daemon.status.display import display
from drivers.aravis import find_cameras
from imaging.errors import AutoexposeError
from imaging.frames import Side
from imaging.pixels import PIXEL_FORMATS

if TYPE_CHECKING:
    from autoexpose_daemon.recording.recorder import Recorder

_LONGEST_US = 7500.0
_PICTURES = 80
REFERENCE_REPEATS = 60
_SEARCH_HOLDS_S = 1.2  # less than the daemon's two seconds: the cameras still have to get ready


def show(options: DemoOptions, cameras: FakeCameras, stop: threading.Event, console: Console) -> Run:
    """Run the daemon on cameras that are starting, then end them."""
    rate_hz = start(cameras, options, console)
    step_log = StepLog(options.seconds / _PICTURES)
    with ExitStack() as resources:
        calibrations: Mapping[Side, Mapping[str, str]] = {}
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
    return Run(options, rate_hz, service.daemon, cameras.both, pulses, step_log, took_s, took_s, cpu_s, reference_ms)


def report(run: Run, console: Console) -> None:
    """Print, write and draw the results of a run.

    Raises
    ------
    AutoexposeError
        When the daemon's account of triggers disagrees with the wire's.
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
    possible_hz = pairs_per_s(cameras.frame_s(), cores(), image_bytes)
    rate_hz = options.rate_hz or min(held_rate_hz(possible_hz), highest_hz)
    words = shortfall(possible_hz, rate_hz, asked=rate_hz == (options.rate_hz or highest_hz))
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
    options: DemoOptions, rate_hz: float, calibrations: Mapping[Side, Mapping[str, str]] = MappingProxyType({})
) -> Config:
    """The configuration of the daemon on the demo's cameras, each with the keys of its calibration."""
    control = {"policy": options.policy, **({"bracket": {}, **SENSOR} if options.bracket else {})}
    return Config.model_validate(
        {
            "cameras": {side: {"serial": serial, **calibrations.get(side, {})} for side, serial in SERIALS.items()},
            "trigger": {"mode": "external", "line": "Line0", "rate_hz": rate_hz},
            "exposure": {"max_time_us": min(_LONGEST_US, 0.8e6 / rate_hz)},
            "control": control,
            "image": {"pixel_format": options.pixel_format},
            "publish": {} if options.publish else None,
        }
    )


def _recorder(options: DemoOptions, config: Config) -> Recorder | None:
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
