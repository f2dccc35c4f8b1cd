"""The product's supervision and control on virtual cameras, in virtual time."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType, SimpleNamespace

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.demo.fakes import places
from autoexpose_daemon.runtime.daemon import silence_s
from autoexpose_daemon.runtime.rig_control import Outlet, RigControl
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.status.states import Expectation, Health, State, judge
from drivers.rig.events import Command, RigEvent
from drivers.rig.supervision import Slots, Supervisor
from imaging.exposure import ExposureLimits
from imaging.frames import CameraName, FrameSet
from tests.soak.camera import LIMITS, Device
from tests.soak.clock import MS, SECOND, Actor, Clock, run

RATE_HZ = 60.0
PERIOD_NS = SECOND / RATE_HZ * (1 + 20e-6)
"""Of the wire: a crystal is off by some ppm."""

BEAT_NS = 100 * MS
POLL_NS = 50 * MS
LOOK_NS = 250 * MS
LONGEST_REST_NS = 3 * SECOND
"""The scripted policy changes its mind at least so often."""


def configuration(cameras: int) -> Config:
    """That of a rig of so many cameras: a stereo pair, or pairs that are exposed each on its own."""
    return Config.model_validate(
        {
            "cameras": {place.name: {"serial": place.name} | place.group for place in places(cameras)},
            "trigger": {"mode": "external", "line": "Line0", "rate_hz": RATE_HZ},
            "exposure": {"max_time_us": LIMITS.max_time_us},
        }
    )


CONFIG = configuration(2)


class ScriptedLoop:
    """Decides without images: the level follows a sine of 20 s and steps every 7 s, and rests in between.

    Each group has less light than the one before it, and other moments.
    """

    flicker_hz: float | None = None
    light_belief: float | None = None
    uncounted: Mapping[CameraName, str] = MappingProxyType({})

    def __init__(self, limits: ExposureLimits, clock: Clock, group: int, groups: int) -> None:
        self.setup = SimpleNamespace(limits=limits)
        self._clock = clock
        self._group, self._groups = group, groups
        self._decision: dict[int, Decision] = {}

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        pair = StepInputs.of(inputs).pair
        self._clock.now_ns += (1 + pair.trigger % 5) * MS // self._groups
        tenths = pair.reference.host_time_ns // (100 * MS) + 23 * self._group
        wave = round(1.5 * math.sin(tenths * math.tau / 200), 1)
        level = 10.0 - self._group + wave + (0.5 if tenths // 70 % 2 else 0.0)
        decision = self._decision.get(round(10 * level))
        if decision is None:
            setting = self.setup.limits.realise(level, 2000.0)
            decision = Decision(setting, level, "scripted", 0.5, 0.0, 0.0, 0.0)
            self._decision[round(10 * level)] = decision
        return decision


class ScriptedTuning(Tuning):
    def __init__(self, config: Config, clock: Clock, group: int = 0, groups: int = 1) -> None:
        super().__init__(config)
        self._clock = clock
        self._group, self._groups = group, groups

    def of_group(self, group: str) -> ScriptedTuning:
        groups = list(self.config.cameras_of_groups)
        return ScriptedTuning(self.config.of_group(group), self._clock, groups.index(group), len(groups))

    def loop(self, limits: ExposureLimits) -> ScriptedLoop:  # type: ignore[override]
        return ScriptedLoop(limits, self._clock, self._group, self._groups)


class Events:
    """The queue between supervision and control: an event is there from the time on at which it was put."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._events: list[tuple[int, int, RigEvent]] = []
        self._order = itertools.count()
        self.control: Actor | None = None

    def put(self, event: RigEvent) -> None:
        heapq.heappush(self._events, (self._clock.now_ns, next(self._order), event))
        assert self.control is not None
        if self._clock.now_ns < self.control.due_ns:
            self.control.plan(self._clock.now_ns)

    def qsize(self) -> int:
        return len(self._events)

    def taken(self) -> list[RigEvent]:
        now_ns, events = self._clock.now_ns, []
        while self._events and self._events[0][0] <= now_ns:
            events.append(heapq.heappop(self._events)[2])
        return events

    @property
    def first_ns(self) -> float:
        return self._events[0][0] if self._events else math.inf


class Unit:
    """A device, its supervisor, and the two actors that stand for the supervisor's threads."""

    def __init__(self, device: Device, events: Events, clock: Clock, config: Config) -> None:
        self.device = device
        self.supervisor = Supervisor(device.camera, device.open, silence_s(config), config.start, events, now_ns=clock)
        self.nodes = Actor(self._serve, clock.now_ns)
        self.frames = Actor(self._take)
        self._clock = clock
        self._poll_ns = 0

    def plan_frames(self) -> None:
        due_ns = self.supervisor.take_due_ns
        if due_ns != math.inf:
            in_flight = self.device.in_flight
            arrival_ns = in_flight[0].arrival_ns if in_flight else math.inf
            due_ns = max(due_ns, min(arrival_ns, self._poll_ns + POLL_NS))
        self.frames.plan(due_ns)

    def plan_nodes(self) -> None:
        self.nodes.plan(max(self.supervisor.serve_due_ns, self._clock.now_ns))

    def _serve(self) -> None:
        self.supervisor.serve()
        self.nodes.held_until_ns = self._clock.now_ns
        self.plan_nodes()
        self._poll_ns = self._clock.now_ns if self.frames.due_ns == math.inf else self._poll_ns
        self.plan_frames()

    def _take(self) -> None:
        self._poll_ns = self._clock.now_ns
        self.supervisor.take_frame()
        self.plan_frames()
        self.plan_nodes()


class VirtualRig:
    """Cameras on a wire, and the daemon's parts on them.

    Parameters
    ----------
    seed
        Of the jitter of cameras and wire.
    outlet
        Takes every pair.
    see_health
        Told of the state of the daemon at every change.
    tuning
        What control goes by; None: a script that looks at no image, on a rig as `config` has it.
    new_device
        Makes a camera.
    """

    def __init__(
        self,
        seed: int,
        outlet: Outlet,
        see_health: Callable[[int, Health], None],
        tuning: Tuning | None = None,
        new_device: Callable[[CameraName, Clock, int], Device] = Device,
        *,
        config: Config = CONFIG,
    ) -> None:
        self.clock = Clock()
        self._events = Events(self.clock)
        tuning = tuning or ScriptedTuning(config, self.clock)
        config = tuning.config
        self.devices = [new_device(camera, self.clock, seed) for camera in config.cameras]
        for device in self.devices:
            device.period_ns = SECOND / config.trigger.rate_hz
        self.units = {device.camera: Unit(device, self._events, self.clock, config) for device in self.devices}
        self.realtime_offset_ns = 1_700_000_000 * SECOND + 123_456_789
        """What the host's clock is ahead of the virtual one; a test may set it."""
        self.control = RigControl(
            tuning.config, self, now_ns=self.clock, realtime_offset_ns=lambda: self.realtime_offset_ns
        )
        self.control.outlets.append(outlet)
        self.control.tune(tuning)
        self._control = self._events.control = Actor(self._take, self.clock.now_ns)
        self._see_health = see_health
        self._health = Health(State.STARTING)
        triggered = config.trigger.mode == "external"
        self._expectation = Expectation(tuple(config.cameras), 1 / config.trigger.rate_hz, triggered, self.clock.now_ns)
        watch = Actor(self._look, self.clock.now_ns)
        self._watch = watch
        self.threads = [self._control, watch, *(a for unit in self.units.values() for a in (unit.nodes, unit.frames))]
        """All that stands still while the process is stopped."""

    def stall_control(self, duration_ns: int) -> None:
        """The control thread is held up."""
        self._control.hold(self.clock.now_ns + duration_ns)

    def stop_process(self, duration_ns: int) -> None:
        """SIGSTOP and, later, SIGCONT."""
        for thread in self.threads:
            thread.hold(self.clock.now_ns + duration_ns)

    def run(self, others: list[Actor], until_ns: int) -> None:
        """Let virtual time pass."""
        run([*others, *self.threads], self.clock, until_ns)

    def pulse(self, number: int) -> None:
        """A pulse on the trigger wire."""
        now_ns = self.clock.now_ns
        for unit in self.units.values():
            unit.device.pulse(number, now_ns)
            unit.plan_frames()

    def write(self, command: Command) -> None:
        """See `Rig.write`."""
        for camera in command.cameras:
            self.units[camera].supervisor.request(command.setting, command.due_ns, command.number)
            self.units[camera].plan_nodes()

    def pace(self, camera: CameraName, slots: Slots) -> None:
        """See `Rig.pace`."""
        self.units[camera].device.slots = slots
        self.units[camera].supervisor.pace(slots)
        self.units[camera].plan_nodes()

    def reopen(self, camera: CameraName, why: str) -> None:
        """See `Rig.reopen`."""
        self.units[camera].supervisor.reopen(why)
        self.units[camera].plan_nodes()

    def _take(self) -> None:
        began_ns = self.clock.now_ns
        self.control.take(self._events.taken())
        self._control.held_until_ns = self.clock.now_ns
        self._control.plan(min(self._events.first_ns, began_ns + BEAT_NS))

    def _look(self) -> None:
        now_ns = self.clock.now_ns
        health = judge(self.control.telemetry, self._expectation, now_ns)
        if health != self._health:
            self._health = health
            self._see_health(now_ns, health)
        self._watch.plan(now_ns + LOOK_NS)
