"""One policy's part of the demo: the lap is taught by `autoexpose teach` and repeated by `autoexpose repeat`."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from autoexpose_daemon.messages.inputs import RegisteredView
from imaging.errors import AutoexposeError
from navigation.demo.robot import (
    ASIDE_M,
    COMMAND,
    JOYSTICK,
    LENGTH_M,
    ODOMETRY,
    RADIUS_M,
    STANDSTILL,
    TURNED_RAD,
    DemoRobot,
    Pose2D,
    RobotSample,
)

TAUGHT_LUX = 150.0

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


@dataclass(frozen=True, slots=True)
class Lap:
    """How a lap went; `said` is what `repeat` printed at its end."""

    light: str
    policy: str
    completed: bool
    steps: Sequence[RobotSample]
    views: Sequence[RegisteredView]
    said: str

    @property
    def errors_m(self) -> list[float]:
        """Distances from the taught lap."""
        return [step.place.aside_m for step in self.steps]

    @property
    def registered_share(self) -> float:
        """Share of the frames looked at that were registered."""
        return sum(view.shift_px is not None for view in self.views) / max(len(self.views), 1)

    def figures(self) -> dict[str, float | str | bool]:
        """The figures for the summary."""
        return {
            "light": self.light,
            "policy": self.policy,
            "completed": self.completed,
            "mean_error_m": round(sum(self.errors_m) / max(len(self.errors_m), 1), 4),
            "max_error_m": round(max(self.errors_m, default=0.0), 4),
            "registered_share": round(self.registered_share, 4),
        }


class Lessons:
    """Teaches a lap and repeats it.

    Parameters
    ----------
    robot
        The robot to drive.
    endpoints
        Options for the commands: where the daemon and the robot are.
    forward_m_s
        How fast to drive.
    stop
        Ends everything.
    """

    def __init__(self, robot: DemoRobot, endpoints: Sequence[str], forward_m_s: float, stop: threading.Event) -> None:
        self._robot, self._endpoints, self._forward_m_s, self._stop = robot, endpoints, forward_m_s, stop

    def teach(self, file: Path) -> None:
        """Drive the lap once, exactly."""
        robot = self._robot
        robot.light(TAUGHT_LUX)
        robot.joystick = STANDSTILL
        robot.put(Pose2D.at_start(), errs=False)
        focal_length = ["--focal-length-px", str(FOCAL_LENGTH_PX)]
        with self._command("teach", str(file), "--velocity", JOYSTICK, *focal_length) as teach:
            self._wait_for(file)
            robot.joystick = self._forward_m_s, self._forward_m_s / RADIUS_M
            if self._stop.wait(LENGTH_M / self._forward_m_s):
                raise AutoexposeError("interrupted while a lap was taught")
            robot.joystick = STANDSTILL
            teach.send_signal(signal.SIGINT)
            said, errors = teach.communicate(timeout=STARTS_S)
        if teach.returncode != 0 or not file.exists():
            raise AutoexposeError(f"autoexpose teach failed: {errors.strip() or said.strip()}")

    def repeat(self, file: Path, light: str, policy: str) -> Lap:
        """Drive the lap again from beside the start, by what the cameras see, in another light."""
        robot, lux_at = self._robot, LIGHTS[light]
        robot.light(lux := lux_at(0.0))
        robot.joystick = None
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
