"""The health of a rig's cameras: what their events reveal, counted, logged, and kept until it is over."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Mapping

from autoexpose_daemon.config.document import Config, PublishConfig
from autoexpose_daemon.runtime.light_spread import LightSpread
from autoexpose_daemon.runtime.response_drift import ResponseDrift
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.runtime.stamp_watch import StampWatch
from autoexpose_daemon.status.states import ADJUSTED, START_PATIENCE_NS
from autoexpose_daemon.status.telemetry import GONE, Telemetry
from drivers.camera import IncompleteFrame, RefusedPackets
from drivers.log_throttle import LogThrottle
from drivers.rig.events import CameraGone, CameraReady, ClockRead, TemperatureRead, WriteFailed, Written
from drivers.triggers import RigRecord
from drivers.triggers.host import HostTriggers
from drivers.triggers.rate import HOST_RATE_TOLERANCE, RATE_TOLERANCE, RateWatch
from drivers.triggers.writes import EffectWatch
from imaging.frames import CameraName, Frame, FrameSet

log = logging.getLogger(__name__)

Kind = str
"""The kind of trouble, such as "refused"; a camera has one trouble of each kind at a time."""


class Troubles:
    """Keeps the troubles of a rig; `present` is read by other threads."""

    def __init__(self, present: dict[tuple[CameraName, Kind], str]) -> None:
        self.present = present
        self._logged: set[tuple[CameraName, Kind, str]] = set()

    def begin(self, camera: CameraName, kind: Kind, sentence: str) -> None:
        """Something is wrong: logged when it begins, not at every repetition."""
        if (camera, kind) not in self.present:
            self._log(camera, kind, sentence)

    def change(self, camera: CameraName, kind: Kind, sentence: str) -> None:
        """The same, but each new sentence is logged."""
        if (camera, kind, sentence) in self._logged:
            self.present[camera, kind] = sentence
        else:
            self._logged.add((camera, kind, sentence))
            self._log(camera, kind, sentence)

    def judge(self, camera: CameraName, kind: Kind, sentence: str | None) -> None:
        """The current verdict; None: nothing is wrong. A new sentence is logged."""
        if sentence is None:
            self.end(camera, kind)
        elif self.present.get((camera, kind)) != sentence:
            self._log(camera, kind, sentence)

    def end(self, camera: CameraName, kind: Kind) -> None:
        """It is over, if it ever began."""
        if self.present.pop((camera, kind), None) is not None:
            self._logged = {logged for logged in self._logged if logged[:2] != (camera, kind)}

    def end_all(self, name: CameraName) -> None:
        """The camera is replaced or gone."""
        for camera, kind in list(self.present):
            if camera == name:
                self.end(name, kind)

    def _log(self, camera: CameraName, kind: Kind, sentence: str) -> None:
        self.present[camera, kind] = sentence
        log.warning("%s camera: %s", camera, sentence)


INCOMPLETE_FRAMES = 20
"""This many in a row are no coincidence."""

_INCOMPLETE = "all its frames arrive incomplete: check its cable, and network or USB for what they can carry"
_NO_METADATA = "its frames no longer say how they were taken: their exposure is inferred from when it was written"


FIRST_PAUSE_NS = 3_000_000_000
LONGEST_PAUSE_NS = 600_000_000_000
"""How long a camera is silent before the first attempt; the pause doubles each time, since reopening does not help if
its trigger wire is cut."""

FLOWING_NS = 500_000_000
PERIODS = 10.0
"""At low rates: another camera has sent a frame within this many periods, and this one has missed more."""

BESIDE_ANOTHER = "sends no frames while another one does"
LIKE_ALL = "sends no frames"


class StuckStreams:
    """Decides when to reopen a camera; for one thread.

    With `needs_pulses`, triggers come from elsewhere: if no camera sends anything, they may have stopped.
    """

    def __init__(self, period_s: float, *, needs_pulses: bool) -> None:
        self._periods_ns, self._needs_pulses = PERIODS * period_s * 1e9, needs_pulses
        self._arrived_ns: dict[CameraName, int] = {}
        self._due_ns: dict[CameraName, float] = {}
        self._pause_ns: dict[CameraName, float] = {}

    def arrived(self, camera: CameraName, now_ns: int) -> None:
        """A frame has arrived, complete or not."""
        self._arrived_ns[camera] = now_ns

    def reasons(
        self, cameras: Mapping[CameraName, str], now_ns: int, untriggered: Collection[CameraName] = ()
    ) -> dict[CameraName, str]:
        """Which cameras to reopen now, and why; those that are not triggered yet cannot be stuck."""
        flowing_ns = max(FLOWING_NS, self._periods_ns)
        flowing = {name for name, last_ns in self._arrived_ns.items() if now_ns - last_ns < flowing_ns}
        stuck: dict[CameraName, str] = {}
        for name, camera in cameras.items():
            if name in flowing:
                self._pause_ns.pop(name, None)
            stopped = self._needs_pulses and not flowing
            if name in flowing or stopped or camera == GONE or name in untriggered:
                self._due_ns.pop(name, None)
                continue
            pause_ns = self._pause_ns.setdefault(name, max(FIRST_PAUSE_NS, 2 * self._periods_ns))
            if now_ns >= self._due_ns.setdefault(name, now_ns + pause_ns):
                stuck[name] = BESIDE_ANOTHER if flowing else LIKE_ALL
                del self._due_ns[name]
                self._pause_ns[name] = min(2 * pause_ns, LONGEST_PAUSE_NS)
        return stuck


_SILENCE_LOG_PAUSE_S = 60.0  # a trigger much slower than configured makes each frame end a silence

_WHOSE_PACKETS = (
    "if this is the camera, give it one address; if not, keep that sender off its network "
    "(docs/understand/hostile-packets.md)"
)


def _light_spread(config: Config) -> LightSpread:
    responses = {camera: file.response for camera, file in config.responses.items()}
    return LightSpread(config.cameras_of_groups.values(), responses)


class RigHealth:
    """Examines what the rig's events say of its cameras, after the record has taken them."""

    def __init__(
        self,
        config: Config,
        telemetry: Telemetry,
        record: RigRecord,
        triggers: HostTriggers,
        realtime_offset_ns: Callable[[], int],
    ) -> None:
        self._telemetry = telemetry
        self._counts, self._cameras = telemetry.counts, telemetry.cameras
        self._troubles = Troubles(telemetry.cameras.troubles)
        tolerance = HOST_RATE_TOLERANCE if config.trigger.by_host else RATE_TOLERANCE
        self._rates = RateWatch(config.trigger.rate_hz, config.trigger_sources, tolerance)
        self._effects = {camera: EffectWatch() for camera in config.cameras}
        self._with_metadata: set[CameraName] = set()
        self._incomplete: Counter[CameraName] = Counter()
        # By PTP, too, cameras expose only on request, which pauses while their clocks are not synchronised.
        needs_pulses = config.trigger.mode in ("external", "ptp")
        self._stuck = StuckStreams(1.0 / config.trigger.rate_hz, needs_pulses=needs_pulses)
        self._drift = ResponseDrift(config)
        self._light = _light_spread(config)
        self._record = record
        self._triggers = triggers
        self._stamps = StampWatch((config.publish or PublishConfig()).stamping)
        self._realtime_offset_ns = realtime_offset_ns
        self._sides = frozenset(config.cameras)
        self._ever_ready: set[CameraName] = set()
        self._out: set[CameraName] = set()
        self._silent: set[CameraName] = set()
        self._throttle = LogThrottle(_SILENCE_LOG_PAUSE_S)

    def arrived(self, camera: CameraName, frame: Frame | IncompleteFrame, stale: bool, now_ns: int) -> None:
        """Look at any frame, whole or not; `stale`: too late for control."""
        self._stuck.arrived(camera, now_ns)
        self._silent.discard(camera)
        self._troubles.end(camera, "strangers")
        if isinstance(frame, IncompleteFrame):
            self._incomplete[camera] += 1
            if self._incomplete[camera] >= INCOMPLETE_FRAMES:
                self._troubles.begin(camera, "incomplete", _INCOMPLETE)
            return
        if (trouble := frame.clock_trouble) is not None:  # told with any complete frame, and once
            self._counts.clock_jumps += trouble.kind == "jump"
            log.warning("%s camera: %s", camera, trouble.sentence)
        if not stale:
            self._cameras.last_frame_ns[camera] = frame.arrival_time_ns
            self._check(camera, frame)

    def _check(self, camera: CameraName, frame: Frame) -> None:
        """Look at the next complete frame of a camera."""
        self._incomplete[camera] = 0
        self._troubles.end(camera, "incomplete")
        self._troubles.judge(camera, "rate", self._rates.frame(camera, frame))
        self._troubles.judge(camera, "effect", self._effects[camera].frame(frame, self._record.history(camera)))
        self._counts.frames_off_setting = sum(watch.frames_off_setting for watch in self._effects.values())
        if frame.setting_source == "chunk":
            self._with_metadata.add(camera)
            self._troubles.end(camera, "metadata")
        elif camera in self._with_metadata:
            self._counts.frames_without_exposure_metadata += 1
            self._troubles.begin(camera, "metadata", _NO_METADATA)

    def silent(self, camera: CameraName, now_ns: int) -> None:
        """A camera sends no frames."""
        if camera not in self._record.unpaced and self._throttle.due(camera, now_ns):
            log.warning("%s camera: no frames; checking that it answers", camera)
        self._rates.gone(camera)
        self._incomplete[camera] = 0
        for kind in ("rate", "incomplete"):
            self._troubles.end(camera, kind)
        self._silent.add(camera)

    def ready(self, event: CameraReady) -> None:
        """A camera is open."""
        name, camera = event.camera, event.description
        self._counts.reconnects += name in self._ever_ready
        self._ever_ready.add(name)
        self._troubles.end(name, GONE)
        log.info("%s camera: %s %s %s, ready", name, camera.vendor, camera.model, camera.serial)
        for limitation in camera.limitations:
            log.warning("%s camera %s: %s", name, camera.serial, limitation)
        self._cameras.names[name] = f"{camera.model} {camera.serial}"
        if camera.link_mbps is not None:
            self._cameras.links_mbps[name] = camera.link_mbps

    def gone(self, event: CameraGone, now_ns: int) -> None:
        """A camera is lost; raises its error if it cannot be driven: at the start, or if none is left."""
        camera = event.camera
        if self._cameras.names.get(camera) != GONE:
            self._troubles.end_all(camera)
        self._cameras.names[camera] = GONE
        self._cameras.ptp.pop(camera, None)
        self._cameras.temperatures_c.pop(camera, None)
        self._cameras.links_mbps.pop(camera, None)
        self._rates.gone(camera)  # everything is judged afresh when it returns
        self._effects[camera].gone()
        self._incomplete[camera] = 0
        self._with_metadata.discard(camera)
        if event.final:
            self._out.add(camera)
            opened_ns = self._telemetry.opened_ns
            starting = opened_ns is None or now_ns - opened_ns < START_PATIENCE_NS
            if self._out == self._sides or (camera not in self._ever_ready and starting):
                raise event.error
        what_now = "it stays out until the daemon is restarted" if event.final else "trying again"
        self._troubles.change(camera, GONE, f"{event.error}; {what_now}")

    def written(self, write: Written) -> None:
        """A camera was written: did it take what was asked for?"""
        self._troubles.end(write.camera, "refused")
        if write.read_back.agrees_with(write.asked):
            self._troubles.end(write.camera, ADJUSTED)
        else:
            self._counts.adjusted_writes += 1
            taken = f"{write.asked} was asked for, the camera took {write.read_back}"
            self._troubles.begin(write.camera, ADJUSTED, taken)

    def write_failed(self, event: WriteFailed) -> None:
        """A camera refused a setting."""
        self._counts.refused_writes += 1
        self._effects[event.camera].gone()  # it may have taken part of it
        self._troubles.begin(event.camera, "refused", f"{event.asked} was refused: {event.error}")

    def packets_refused(self, camera: CameraName, packets: RefusedPackets) -> None:
        """Packets of somebody else came instead of a camera's."""
        self._counts.refused_packets += packets.count
        if camera in self._silent:
            self._troubles.begin(camera, "strangers", f"{packets}: {_WHOSE_PACKETS}")

    def told(self, event: ClockRead | TemperatureRead, now_ns: int) -> None:
        """A camera says how its clock is synchronised, or how warm it is."""
        if isinstance(event, TemperatureRead):
            self._cameras.temperatures_c[event.camera] = event.temperature_c
            return
        self._cameras.ptp[event.camera] = event.reading.ptp
        ptp_ns = self._triggers.ptp_time_ns(now_ns)
        if ptp_ns is not None:
            self._stamps.look(ptp_ns, now_ns + self._realtime_offset_ns())

    def pair(self, pair: FrameSet) -> None:
        """Look at a set: do the cameras respond as calibrated, and see the same light?"""
        self._drift.see(pair)
        self._light.look(pair)
        for camera in pair.frames:
            self._troubles.judge(camera, "light", self._light.sentences.get(camera))
        self._cameras.drift_grey, self._cameras.misfits = self._drift.residual_grey, self._drift.misfits

    def counted(self, pair: FrameSet, uncounted: Mapping[CameraName, str]) -> None:
        """Note which frames of a pair did not count for the decision on it, and why."""
        for camera in pair.frames:
            self._troubles.judge(camera, "uncounted", uncounted.get(camera))

    def tune(self, tuning: Tuning) -> None:
        """Continue with the responses of another tuning."""
        self._drift, self._light = ResponseDrift(tuning.config), _light_spread(tuning.config)

    def look(self, now_ns: int) -> dict[CameraName, str]:
        """To be called at least ten times a second; returns the cameras to reopen, and why."""
        for finding in self._record.findings(now_ns):
            log.warning("%s", finding)
        for camera in self._cameras.present:
            self._troubles.judge(camera, "clock", self._triggers.trouble(camera, now_ns))
        return self._stuck.reasons(self._cameras.names, now_ns, self._record.unpaced)
