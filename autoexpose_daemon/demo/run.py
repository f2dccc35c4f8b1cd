"""Running the demo from its first process to its last figure."""

from __future__ import annotations

import gc
import json
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.console import Console
from rich.table import Table

from autoexpose_daemon.cameras import openers
from autoexpose_daemon.config import Config
from autoexpose_daemon.control.policies import check_policy_id
from autoexpose_daemon.daemon import Daemon
from autoexpose_daemon.demo.fakes import SERIALS, Pulse, check_simulator, fake_cameras, read_pulses
from autoexpose_daemon.demo.record import Recorder
from autoexpose_daemon.demo.report import LightStep, delay_frames, light_steps, pulses_in_window
from autoexpose_daemon.demo.usb_bus import begin_again_on_fake_bus, cameras_on_bus
from autoexpose_daemon.outlets import add_outlets
from autoexpose_daemon.recording import check_recording_extra
from autoexpose_daemon.reference_step import reference_step_ms
from autoexpose_daemon.service import Service, run_until_stopped
from drivers.errors import AutoexposeError, ConfigurationError

if TYPE_CHECKING:
    from autoexpose_daemon.recording.recorder import Recorder as FileRecorder

_LONGEST_US = 7500.0
_PICTURE_PERIOD_S = 0.25
_REFERENCE_REPEATS = 60


Transport = Literal["gige", "usb3"]


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """What the demo is asked for on the command line."""

    seconds: float
    policy: str
    summary: Path | None
    plot: Path | None
    scene: str
    light: Path | None
    seed: int
    transport: Transport
    rate_hz: float
    still: bool
    publish: bool
    record: Path | None


def run_demo(options: DemoOptions, stop: threading.Event, console: Console) -> None:
    """Run the daemon on two fake cameras and report.

    Raises
    ------
    AutoexposeError
        When the fakes do not start, or when the daemon's account of triggers disagrees with the wire's.
    """
    check_simulator()
    _check_writable(options.summary, options.plot)
    config = _configuration(options)
    sockets = cameras_on_bus()
    if options.transport == "usb3" and not sockets:
        begin_again_on_fake_bus()
    arguments = ["--scene", options.scene, "--seed", str(options.seed), "--line0-rate-hz", str(options.rate_hz)]
    arguments += ["--still"] if options.still else []
    if options.light is not None:
        arguments += ["--light", str(options.light)]
    recorder = Recorder(_PICTURE_PERIOD_S)
    with ExitStack() as resources:
        folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="autoexpose-demo-")))
        if sockets:
            resources.callback(shutil.rmtree, sockets["left"].parent)
        console.print("starting two fake cameras ... (the first start compiles their renderer)")
        with fake_cameras(folder, arguments, f"demo-{os.getpid()}", sockets, stop) as truths:
            file = _recorder(options, config)
            if file is not None:
                resources.enter_context(file)
            service = Service(
                config,
                lambda config, start: add_outlets(Daemon(config, openers(config), recorder, start), config, file),
            )
            daemon = service.daemon
            cpu_percent = _run_for(options.seconds, service, stop, console, f"autoexpose demo, {options.policy}")
            reference_ms = reference_step_ms(_REFERENCE_REPEATS)
            pulses = pulses_in_window(read_pulses(truths), daemon.tally)
    if file is not None:
        console.print(file.summary)
    steps = light_steps(pulses, recorder.steps)
    figures = _figures(options, daemon, pulses, steps)
    figures |= {"delay_frames": delay_frames(recorder.steps), "first_trigger": pulses[0].trigger if pulses else None}
    figures |= {"daemon_cpu_percent": cpu_percent, "reference_step_ms": round(reference_ms, 3)}
    _print_figures(console, figures, steps)
    if options.summary is not None:
        options.summary.write_text(json.dumps(figures, indent=2) + "\n")
    if options.plot is not None:
        from autoexpose_daemon.demo.plot import draw  # noqa: PLC0415  matplotlib takes a second to load

        draw(options.plot, pulses, recorder, f"autoexpose demo: policy {options.policy}, scene {options.scene}")
        console.print(f"picture of the run: {options.plot}")
    if figures["triggers"] != figures["pairs"] + sum(figures["lost"].values()):
        raise AutoexposeError(
            f"the account does not balance: {figures['triggers']} triggers on the wire, "
            f"{figures['pairs']} pairs and {sum(figures['lost'].values())} losses accounted for"
        )


def _configuration(options: DemoOptions) -> Config:
    check_policy_id(options.policy)
    return Config.model_validate(
        {
            "cameras": {side: {"serial": serial} for side, serial in SERIALS.items()},
            "trigger": {"mode": "external", "line": "Line0", "rate_hz": options.rate_hz},
            "exposure": {"max_time_us": min(_LONGEST_US, 0.8e6 / options.rate_hz)},
            "control": {"policy": options.policy},
            "publish": {} if options.publish else None,
        }
    )


def _recorder(options: DemoOptions, config: Config) -> FileRecorder | None:
    if options.record is None:
        return None
    check_recording_extra()
    from autoexpose_daemon.recording.recorder import new_recorder  # noqa: PLC0415

    return new_recorder(options.record, config, None)


def _check_writable(*files: Path | None) -> None:
    """Before the run, not after it."""
    for file in files:
        if file is not None and (file.is_dir() or not os.access(file.absolute().parent, os.W_OK)):
            raise ConfigurationError(f"{file}: cannot be written; name a file in a folder that is there")


def _run_for(seconds: float, service: Service, stop: threading.Event, console: Console, title: str) -> float:
    """Run the daemon for a time; returns the CPU time of this process in percent of the time it took."""
    gc.freeze()
    timer = threading.Timer(seconds, stop.set)
    timer.start()
    started_s, cpu_s = time.monotonic(), time.process_time()
    try:
        run_until_stopped(service, stop, console, title)
    finally:
        timer.cancel()
    return round(100 * (time.process_time() - cpu_s) / (time.monotonic() - started_s), 1)


def _figures(options: DemoOptions, daemon: Daemon, pulses: list[Pulse], steps: list[LightStep]) -> dict[str, Any]:
    tally, telemetry = daemon.tally, daemon.telemetry
    seconds = ((tally.window_end_ns or 0) - (tally.window_start_ns or 0)) * 1e-9
    return {
        "transport": options.transport,
        "policy": options.policy,
        "seconds": round(seconds, 3),
        "fps": round(tally.pairs / seconds, 2) if seconds else 0.0,
        "triggers": len(pulses),
        "pairs": tally.pairs,
        "lost": {str(reason): count for reason, count in tally.lost.items() if count},
        "undecided_pairs": telemetry.undecided_pairs,
        "mismatched_pairs": telemetry.mismatched_pairs,
        "unexplained_mismatches": telemetry.unexplained_mismatches,
        "late_writes": telemetry.late_writes,
        "steps": [_step_as_json(step) for step in steps],
        "pairing_ms": telemetry.pairing_ms.percentiles(),
        "decision_ms": telemetry.decision_ms.percentiles(),
        "held_ms": telemetry.held_ms.percentiles(),
        "write_ms": telemetry.write_ms.percentiles(),
        "frame_to_node_ms": telemetry.frame_to_node_ms.percentiles(),
        "published": None if telemetry.publishing is None else telemetry.publishing.sent,
    }


def _step_as_json(step: LightStep) -> dict[str, float | int | None]:
    keys = ("time_s", "from_lux", "to_lux", "frames_to_steady", "frames_to_settle")
    return {key: getattr(step, key) for key in keys}


def _print_figures(console: Console, figures: Mapping[str, Any], steps: list[LightStep]) -> None:
    table = Table(box=None, show_header=False, padding=(0, 2))
    lost = ", ".join(f"{count} {reason}" for reason, count in figures["lost"].items()) or "none"
    table.add_row("triggers on the wire", str(figures["triggers"]))
    table.add_row("stereo pairs", f"{figures['pairs']} ({figures['fps']} per second)")
    table.add_row("lost, by reason", lost)
    table.add_row("mismatched pairs", str(figures["mismatched_pairs"]))
    if figures["published"] is not None:
        table.add_row("published", str(figures["published"]))
    for name, key in (
        ("pairing", "pairing_ms"),
        ("decision", "decision_ms"),
        ("held", "held_ms"),
        ("writing nodes", "write_ms"),
        ("frame to node", "frame_to_node_ms"),
    ):
        if figures[key]["p50"] is not None:
            table.add_row(name, f"{figures[key]['p50']:.2f} ms, p99 {figures[key]['p99']:.2f} ms")
    table.add_row("daemon CPU", f"{figures['daemon_cpu_percent']} % of one core")
    table.add_row("literal step here", f"{figures['reference_step_ms']} ms (yardstick of this machine's speed)")
    for step in steps:
        table.add_row(
            f"light step at {step.time_s:.1f} s", f"{step.from_lux:g} to {step.to_lux:g} lux: {step.in_words}"
        )
    console.print(table)
