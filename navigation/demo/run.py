"""`autoexpose demo --navigate`: two policies teach a lap and repeat it in three lights."""

from __future__ import annotations

import dataclasses
import json
import math
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.console import Console
from rich.table import Table

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.demo.analysis import DemoRun, StepLog, figures, in_words, light_steps, pulses_in_window
from autoexpose_daemon.demo.fakes import FakeCameras, read_pulses
from autoexpose_daemon.demo.options import DemoOptions
from autoexpose_daemon.demo.reference_step import reference_step_ms
from autoexpose_daemon.demo.show import REFERENCE_REPEATS, check_account, configuration, start
from autoexpose_daemon.messages.keys import LOOPBACK
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.setup import openers
from autoexpose_daemon.service.service import Service, add_outlets
from imaging.errors import AutoexposeError
from navigation.demo.lessons import LIGHTS, Lap, Lessons
from navigation.demo.robot import LENGTH_M, ControlLine, DemoRobot

OTHER_POLICY = "fixed"

BEGINS_S, WAITS_S = 4.0, 3.0
"""The time that a daemon takes to begin and end, and the time that a command takes."""

FASTEST_M_S = 0.6

HIGHEST_HZ = 30.0
"""Two fakes in motion, a daemon, and `teach` or `repeat`, which look at each frame, are a lot for two cores."""

_RIG = "rig"


@contextmanager
def running(service: Service) -> Iterator[None]:
    """Run a service on a thread, and raise what ended it."""
    stop, failed = threading.Event(), list[BaseException]()

    def run() -> None:
        try:
            service.run(stop, lambda _status: None)
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, name="daemon")
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
    if failed:
        raise failed[0]


@dataclasses.dataclass(frozen=True, slots=True)
class Part:
    """A policy's part: the run of the daemon, and its laps."""

    service: Service
    step_log: StepLog
    laps: Sequence[Lap]
    took_s: float
    cpu_s: float


def navigate(options: DemoOptions, cameras: FakeCameras, folder: Path, stop: threading.Event, console: Console) -> None:
    """Teach and repeat on cameras that are starting, end them, and report.

    Raises
    ------
    AutoexposeError
        When a command fails, or the account of triggers does not balance.
    """
    rate_hz = start(cameras, options, console, HIGHEST_HZ)
    daemon_at, robot_at = (f"tcp/127.0.0.1:{port}" for port in _free_ports())
    if options.publish:
        daemon_at = LOOPBACK
    config = configuration(options, rate_hz)
    policies = compared(options.policy)
    commands = len(policies) * (1 + len(LIGHTS))
    lap_s = (options.seconds - len(policies) * BEGINS_S - commands * WAITS_S) / commands
    forward_m_s = min(LENGTH_M / max(lap_s, 1.0), FASTEST_M_S)
    parts: dict[str, Part] = {}
    with ExitStack() as resources:
        lines = [resources.enter_context(ControlLine(camera.control)) for camera in cameras.both]
        robot = resources.enter_context(DemoRobot(robot_at, daemon_at, lines, _RIG))
        lessons = Lessons(robot, ["--connect", daemon_at, "--robot", robot_at, "--rig", _RIG], forward_m_s, stop)
        for policy in policies:
            ours = {"control": {"policy": policy}, "publish": {"rig": _RIG, "listen": [daemon_at]}}
            changed = Config.model_validate(config.model_dump(mode="json", exclude_none=True) | ours)
            parts[policy] = _part(changed, lessons, folder / f"{policy}.map", console.print)
        refused = next((line.refused for line in lines if line.refused), "")
    cameras.end()
    if refused:
        raise AutoexposeError(f"a fake camera refused an order: {refused}")
    _report(options, rate_hz, cameras, parts, console)


def compared(policy: str) -> list[str]:
    """The policies that drive the lap, each once: a map is not taught twice."""
    return list(dict.fromkeys((policy, OTHER_POLICY)))


def _part(config: Config, lessons: Lessons, file: Path, say: Callable[[str], None]) -> Part:
    policy, step_log = config.control.policy, StepLog(math.inf)
    began_s, cpu_s = time.monotonic(), time.process_time()
    service = Service(
        config,
        lambda config, begin: add_outlets(Daemon(config, openers(config), begin, [step_log]), config),
    )
    with running(service):
        say(f"{policy}: teaching a lap of {LENGTH_M:.1f} m ...")
        lessons.teach(file)
        laps: list[Lap] = []
        for light in LIGHTS:
            laps.append(lessons.repeat(file, light, policy))
            say(f"{policy}, {light}: {laps[-1].said}")
    return Part(service, step_log, laps, time.monotonic() - began_s, time.process_time() - cpu_s)


def _report(
    options: DemoOptions, rate_hz: float, cameras: FakeCameras, parts: dict[str, Part], console: Console
) -> None:
    part = parts[options.policy]
    laps = [lap for one in parts.values() for lap in one.laps]
    pulses = pulses_in_window(read_pulses(cameras.truths), part.service.daemon.tally)
    reference_ms = reference_step_ms(REFERENCE_REPEATS)
    run = DemoRun(
        options, rate_hz, part.service.daemon, cameras.both, pulses, part.step_log, part.took_s,
        sum(one.took_s for one in parts.values()), part.cpu_s, reference_ms,
    )  # fmt: skip
    steps = light_steps(run.pulses, run.step_log.steps)
    result = figures(run, steps) | {"laps": [lap.figures() for lap in laps]}
    console.print(in_words(result, steps))
    console.print(laps_in_words(laps))
    if options.summary is not None:
        options.summary.write_text(json.dumps(result, indent=2) + "\n")
    if options.plot is not None:
        from navigation.demo.picture import draw  # noqa: PLC0415  matplotlib takes a second to load

        draw(options.plot, laps, {policy: one.step_log for policy, one in parts.items()})
        console.print(f"picture of the laps: {options.plot}")
    check_account(result)


def laps_in_words(laps: Sequence[Lap]) -> Table:
    """A line for each lap."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for head in ("repeated", "policy"):
        table.add_column(head)
    for head in ("frames registered", "aside, mean", "most"):
        table.add_column(head, justify="right")
    table.add_column("came to the end")
    for lap in laps:
        said = lap.figures()
        table.add_row(
            lap.light, lap.policy, f"{lap.registered_share:.0%}", f"{said['mean_error_m']:.2f} m",
            f"{said['max_error_m']:.2f} m", "yes" if lap.completed else "no",
        )  # fmt: skip
    return table


def _free_ports() -> list[int]:
    with socket.socket() as one, socket.socket() as other:
        for each in (one, other):
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in (one, other)]
