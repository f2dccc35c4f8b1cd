"""`autoexpose demo --navigate`: two policies teach a lap and repeat it in three lights."""

from __future__ import annotations

import json
import math
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.demo.analysis import DemoRun, StepLog, figures, in_words, light_steps, pulses_in_window
from autoexpose_daemon.demo.fakes import FakeCameras, read_pulses
from autoexpose_daemon.demo.options import DemoOptions
from autoexpose_daemon.demo.reference_step import reference_step_ms
from autoexpose_daemon.demo.run import cache_folder
from autoexpose_daemon.demo.show import REFERENCE_REPEATS, check_account, configuration, start
from autoexpose_daemon.messages.sockets import daemon_endpoint
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.setup import openers
from autoexpose_daemon.service.service import Service, add_outlets
from imaging.errors import AutoexposeError
from navigation.demo.robot import (
    ASIDE_M,
    COMMAND,
    JOYSTICK,
    LENGTH_M,
    ODOMETRY,
    TAUGHT_LUX,
    TURNED_RAD,
    ControlLine,
    DemoRobot,
    Lap,
    Pose2D,
)

FOCAL_LENGTH_PX = 860.0
"""The focal length of the fake cameras."""

STARTS_S, STANDS_S = 15.0, 2.0
"""A command has started to drive within this time, and has given up if the robot stands still for this long."""

_TURN_S = 0.02
_AUTOEXPOSE = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()"]

Light = Callable[[float], float]
"""From the share of the lap that is behind the robot (0..1) to lux."""

LIGHTS: dict[str, Light] = {
    "as taught": lambda _progress: TAUGHT_LUX,
    "dusk": lambda _progress: TAUGHT_LUX / 100,
    "off and on": lambda progress: TAUGHT_LUX / 300 if 1 / 3 <= progress < 2 / 3 else TAUGHT_LUX,
}
"""The lights in which the lap is repeated; the last one goes out for the middle third."""


class Lessons:
    """Teaches a lap by `autoexpose teach` and repeats it by `autoexpose repeat`, until `stop` is set.

    `endpoints` are the options that tell the commands where the daemon and the robot are.
    """

    def __init__(self, robot: DemoRobot, endpoints: Sequence[str], forward_m_s: float, stop: threading.Event) -> None:
        self._robot, self._endpoints, self._forward_m_s, self._stop = robot, endpoints, forward_m_s, stop

    def teach(self, file: Path) -> None:
        """Drive the lap once, exactly; raises AutoexposeError if that is interrupted, or nothing was taught."""
        robot = self._robot
        robot.light(TAUGHT_LUX)
        robot.joystick_m_s = 0.0
        robot.put(Pose2D.at_start(), errs=False)
        focal_length = ["--focal-length-px", str(FOCAL_LENGTH_PX)]
        with self._command("teach", str(file), "--velocity", JOYSTICK, *focal_length) as teach:
            self._wait_for(file)
            robot.joystick_m_s = self._forward_m_s
            while robot.driven_m < LENGTH_M - 1e-6:
                if self._stop.wait(_TURN_S):
                    raise AutoexposeError("interrupted while a lap was taught")
            teach.send_signal(signal.SIGINT)
            said, errors = teach.communicate(timeout=STARTS_S)
        if teach.returncode != 0 or not file.exists():
            raise AutoexposeError(f"autoexpose teach failed: {errors.strip() or said.strip()}")

    def repeat(self, file: Path, light: str, policy: str) -> Lap:
        """Drive the lap again from beside the start, by what the cameras see, in one of `LIGHTS`.

        Raises AutoexposeError when it is interrupted.
        """
        robot, lux_at = self._robot, LIGHTS[light]
        robot.light(lux := lux_at(0.0))
        robot.joystick_m_s = None
        robot.put(Pose2D.at_start(ASIDE_M, TURNED_RAD), errs=True)
        with self._command("repeat", str(file), "--command", COMMAND, "--drive") as repeat:
            gives_up_s, last = time.monotonic() + STARTS_S, robot.place
            while repeat.poll() is None and time.monotonic() < gives_up_s and not self._stop.wait(_TURN_S):
                place = robot.place
                if place != last:
                    gives_up_s, last = time.monotonic() + STANDS_S, place
                wanted = lux_at(place.progress if place.progress < 0.98 else 0.0)
                if wanted != lux:
                    robot.light(lux := wanted)
            if self._stop.is_set():
                raise AutoexposeError(f"interrupted while `{policy}` repeated the lap in the light `{light}`")
            completed = repeat.poll() == 0
            repeat.terminate()
            said, _ = repeat.communicate(timeout=STARTS_S)
        steps = [step for step in robot.steps if step.place != robot.steps[0].place]
        return Lap(light, policy, completed, steps, list(robot.views), said.strip().splitlines()[-1] if said else "")

    def _wait_for(self, file: Path) -> None:
        deadline_s = time.monotonic() + STARTS_S
        while not file.exists():
            if self._stop.wait(_TURN_S) or time.monotonic() > deadline_s:
                raise AutoexposeError("autoexpose teach was interrupted, or did not begin in time")

    @contextmanager
    def _command(self, name: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
        command = [*_AUTOEXPOSE, name, *arguments, "--odometry", ODOMETRY, *self._endpoints]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )  # Ctrl-C is for the demo
        with process:
            try:
                yield process
            finally:
                process.kill()


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
    stop = threading.Event()
    with ThreadPoolExecutor(1, "daemon") as pool:
        ended = pool.submit(service.run, stop, lambda _status: None)
        try:
            yield
        finally:
            stop.set()
    ended.result()


@dataclass(frozen=True, slots=True)
class Part:
    """A policy's part: the run of the daemon, and its laps."""

    service: Service
    step_log: StepLog
    laps: Sequence[Lap]
    took_s: float
    cpu_s: float


def navigate(options: DemoOptions, cameras: FakeCameras, folder: Path, stop: threading.Event, console: Console) -> None:
    """Teach and repeat on cameras that are starting, end them, and report.

    Raises AutoexposeError when a command fails, or the account of triggers does not balance.
    """
    rate_hz = start(cameras, options, console, HIGHEST_HZ)
    daemon_at, robot_at = (f"tcp/127.0.0.1:{port}" for port in _free_ports())
    if options.publish:
        daemon_at = daemon_endpoint(_RIG)
    config = configuration(options, rate_hz)
    policies = list(dict.fromkeys((options.policy, OTHER_POLICY)))  # each once: a map is not taught twice
    commands = len(policies) * (1 + len(LIGHTS))
    lap_s = (options.seconds - len(policies) * BEGINS_S - commands * WAITS_S) / commands
    forward_m_s = min(LENGTH_M / max(lap_s, 1.0), FASTEST_M_S)
    parts: dict[str, Part] = {}
    with ExitStack() as resources:
        lines = [resources.enter_context(ControlLine(camera.control)) for camera in cameras.all]
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
    console.print(_kept(folder / f"{options.policy}.map"), markup=False, highlight=False, soft_wrap=True)


def _part(config: Config, lessons: Lessons, file: Path, say: Callable[[str], None]) -> Part:
    policy, step_log = config.control.policy, StepLog(math.inf)
    began_s, cpu_s = time.monotonic(), time.process_time()
    service = Service(
        config, lambda config, begin: add_outlets(Daemon(config, openers(config), begin, [step_log]), config)
    )
    with running(service):
        say(f"{policy}: teaching a course of {LENGTH_M:.1f} m ...")
        lessons.teach(file)
        laps: list[Lap] = []
        for light in LIGHTS:
            laps.append(lessons.repeat(file, light, policy))
            say(f"{policy}, {light}: {laps[-1].said}")
    return Part(service, step_log, laps, time.monotonic() - began_s, time.process_time() - cpu_s)


def _report(
    options: DemoOptions, rate_hz: float, cameras: FakeCameras, parts: dict[str, Part], console: Console
) -> None:
    reference_ms, pulses = reference_step_ms(REFERENCE_REPEATS), read_pulses(cameras.truths)
    took_s = sum(part.took_s for part in parts.values())
    by_policy: dict[str, dict[str, Any]] = {}
    for policy, part in parts.items():
        daemon, log = part.service.daemon, part.step_log
        run = DemoRun(
            replace(options, policy=policy), rate_hz, daemon, cameras.all, pulses_in_window(pulses, daemon.tally), log,
            part.took_s, took_s, part.cpu_s, reference_ms,
        )  # fmt: skip
        by_policy[policy] = figures(run, light_steps(run.pulses, log.steps))
        console.print(f"[bold]{policy}[/bold]")
        console.print(in_words(by_policy[policy], []))
    laps = [lap for part in parts.values() for lap in part.laps]
    console.print(laps_in_words(laps))
    result = by_policy[options.policy] | {"laps": [lap.figures() for lap in laps], "policies": by_policy}
    if options.summary is not None:
        options.summary.write_text(json.dumps(result, indent=2) + "\n")
    if options.plot is not None:
        from navigation.demo.picture import draw  # noqa: PLC0415  matplotlib takes a second to load

        draw(options.plot, laps, {policy: part.step_log for policy, part in parts.items()})
        console.print(f"picture of the laps: {options.plot}")
    for said in by_policy.values():
        check_account(said)


def keep(map_file: Path, folder: Path) -> Path:
    """Copy a map into a folder, whatever was there before; returns the copy."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / f"demo-{map_file.name}"
    with closing(sqlite3.connect(map_file)) as one, closing(sqlite3.connect(kept)) as other:
        one.backup(other)  # with what is still in the journal beside it
    return kept


def _kept(map_file: Path) -> str:
    """Keep the map of the demo, if this user has a cache directory; what can be tried on it, in words."""
    folder = cache_folder()
    if folder is None:
        return ""
    try:
        kept = keep(map_file, folder)
    except (OSError, sqlite3.Error) as error:
        return f"the map that was taught is not kept: {error}"
    tries = f"    autoexpose map info {kept}\n    autoexpose map report {kept} lap.html"
    return f"the map that was taught with {map_file.stem} is kept; look at it with\n{tries}"


def laps_in_words(laps: Sequence[Lap]) -> Table:
    """A line for each lap."""
    heads = ("repeated", "policy", "frames registered", "aside, mean", "most", "at last", "came to the end")
    table = Table(*heads, box=None, pad_edge=False, header_style="bold")
    for column in table.columns[2:6]:
        column.justify = "right"
    for lap in laps:
        said = lap.figures()
        table.add_row(
            lap.light, lap.policy, f"{said['registered_share']:.0%}", f"{said['mean_error_m']:.2f} m",
            f"{said['max_error_m']:.2f} m", f"{said['end_error_m']:.2f} m", "yes" if lap.completed else "no",
        )  # fmt: skip
    return table


def _free_ports() -> list[int]:
    with socket.socket() as one, socket.socket() as other:
        for each in (one, other):
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in (one, other)]
