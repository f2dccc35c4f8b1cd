"""The status of a daemon on this machine or another, and those of all rigs that can be reached, worst first."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import zenoh

from autoexpose_daemon.control.decision import Grounds
from autoexpose_daemon.messages.client import LARGEST_RESPONSE_BYTES, response_from_json
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.inputs import LARGEST_REGISTRATION_BYTES, RegisteredView, read_registration
from autoexpose_daemon.messages.keys import (
    RIG_NAME,
    camera_of,
    check_rig_name,
    last_but,
    response_key,
    rig_key,
)
from autoexpose_daemon.messages.sockets import found_endpoints, searched
from autoexpose_daemon.publish.session import Endpoints, SessionHolder
from autoexpose_daemon.status.document import LARGEST_STATUS_BYTES, Status, grounds_from_json
from autoexpose_daemon.status.panel import losses, lost_in_words, newest_setting
from autoexpose_daemon.status.states import State
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName
from imaging.python310 import Self, StrEnum
from imaging.response import ResponseFunction

SILENT_S = 5.0
"""A daemon that has been silent this long counts as down; it sends its status once a second."""

_RING_MESSAGES = 4

_PATIENCE_S = 0.5

_LONGEST_SINCE_REGISTRATION_S = 1.0
"""If `repeat` has not registered a frame for this long, it has ended, or gets no frames."""


class StatusClient:
    """Follows the status that a rig's daemon sends once a second, and what `repeat` says, while its context is entered.

    It waits for a daemon that has not started yet, and finds it again after a restart. Readable from any thread.
    Parameters and errors are those of `StereoClient`.

    Attributes
    ----------
    status
        The latest; None before the first.
    responses
        The response function of each camera.
    trouble
        Why there is no connection, in words; empty if there is one.
    """

    def __init__(self, rig: str = "rig", connect: Sequence[str] | None = None, zenoh_file: Path | None = None) -> None:
        check_rig_name(rig)
        self.status: Status | None = None
        self.responses: dict[CameraName, ResponseFunction] = {}
        self.trouble = "not connected yet"
        self.rig = rig
        self._heard_s = time.monotonic()
        self._registered: tuple[RegisteredView, float] | None = None
        self._count = 0
        self._news = threading.Condition()
        self.endpoints = Endpoints.of_rig(rig, connect, zenoh_file)
        self._holder = SessionHolder("client", self.endpoints, self._serve, self._on_trouble)

    @property
    def silent_s(self) -> float:
        """Time since the last status, or before the first, since this client was made."""
        return time.monotonic() - self._heard_s

    @property
    def registered(self) -> RegisteredView | None:
        """The newest frame that `autoexpose repeat` registered; None after a second without one."""
        newest = self._registered
        fresh = newest is not None and time.monotonic() - newest[1] < _LONGEST_SINCE_REGISTRATION_S
        return newest[0] if newest is not None and fresh else None

    def ask_grounds(self, group: str | None = None) -> Grounds | None:
        """Ask the daemon what the latest decision of a group rests on; None: of the first one.

        The answer is None if its policy has no belief, or if the daemon does not answer.
        """
        key = rig_key(self.rig, "grounds")
        answer = self._holder.ask(key if group is None else f"{key}?group={group}", _PATIENCE_S)
        return None if answer is None else grounds_from_json(answer)

    def wait(self, timeout_s: float) -> Status | None:
        """The next status; None if none came in time, or the client was closed."""
        with self._news:
            seen = self._count
            self._news.wait_for(lambda: self._count != seen or self._holder.closed.is_set(), timeout_s)
            return self.status if self._count != seen else None

    def __enter__(self) -> Self:
        self._holder.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._holder.closed.set()
        with self._news:
            self._news.notify_all()
        self._holder.close()

    def _on_trouble(self, trouble: str) -> None:
        self.trouble = trouble

    def _serve(self, session: zenoh.Session) -> None:
        subscribe = self._holder.subscribe
        status, responses = rig_key(self.rig, "status"), response_key(self.rig, "*")
        subscribe(session, status, self._take_status, _RING_MESSAGES, LARGEST_STATUS_BYTES)
        subscribe(session, responses, self._take_response, _RING_MESSAGES, LARGEST_RESPONSE_BYTES)
        registration = rig_key(self.rig, "registration")
        subscribe(session, registration, self._take_registration, 1, LARGEST_REGISTRATION_BYTES)
        self._holder.closed.wait()

    def _take_response(self, key: str, data: bytes) -> None:
        camera, response = camera_of(key), response_from_json(data)
        if camera is not None and response is not None:
            self.responses[camera] = response

    def _take_registration(self, _key: str, data: bytes) -> None:
        with contextlib.suppress(DamagedMessageError):  # a damaged one is not shown
            self._registered = read_registration(data), time.monotonic()

    def _take_status(self, _key: str, data: bytes) -> None:
        status = Status.from_json(data)
        if status is None:
            return
        with self._news:
            self.status, self._heard_s = status, time.monotonic()
            self._count += 1
            self._news.notify_all()


MOST_RIGS = 200
"""How many are listed: those heard first. Anyone can invent keys, but memory is limited."""

TOO_MANY_LOST = 0.01
"""A rig that loses a larger share of its triggers is `LOSING`; examples/alerts.yaml has the same limit."""

_RECENT_S = 60.0
_SAMPLE_S = 1.0
_CROWDED_S = 10.0
_LONGEST_NAME = 100
_LONGEST_REASON = 300


class Condition(StrEnum):
    """How a rig is, from worst to best."""

    FAILED = "failed"
    SILENT = "silent"
    DEGRADED = "degraded"
    LOSING = "losing triggers"
    ENDED = "ended"
    STARTING = "starting"
    EXPOSING = "exposing"


_RANKS = {condition: rank for rank, condition in enumerate(Condition)}
_OF_STATE = {state: Condition[state.name] for state in State}


@dataclass(frozen=True, slots=True)
class RigLine:
    """A rig at one moment.

    `why` says in words why its condition is not better, `age_s` how old its last status is. `lost` are the triggers
    lost to faults since its cameras were opened, `lost_share` their share of all triggers of the last minute, 0 until a
    second status arrives. `rate_hz` counts complete pairs; `setting` is the newest frame's, None before the first.
    """

    rig: str
    condition: Condition
    why: str
    age_s: float
    rate_hz: float
    lost: int
    lost_share: float
    setting: ExposureSetting | None


@dataclass(slots=True)
class _Rig:
    """What is kept of a rig: a status may take a megabyte, this takes some kilobytes."""

    heard_s: float = 0.0
    condition: Condition = Condition.STARTING
    ending: bool = False
    reasons: str = ""
    lost_words: str = ""
    rate_hz: float = 0.0
    setting: ExposureSetting | None = None
    counts: deque[tuple[float, int, int]] = field(default_factory=deque)
    """Time, pairs and losses: at most one entry a second, from the last minute; the last entry is the newest."""

    def take(self, status: Status, now_s: float) -> None:
        self.heard_s, self.condition, self.ending = now_s, _OF_STATE[status.state], status.ending
        self.reasons = "; ".join(status.reasons)[:_LONGEST_REASON]
        self.lost_words = lost_in_words(status.lost)[:_LONGEST_REASON]
        self.rate_hz, self.setting = status.rate_hz, newest_setting(status)
        lost_to_faults = sum(count for _, count, is_fault in losses(status.lost) if is_fault)
        self._count(now_s, status.counts.pairs, lost_to_faults)

    def line(self, rig: str, now_s: float, silent_s: float) -> RigLine:
        age_s, lost_share = now_s - self.heard_s, self.lost_share
        condition, why = self.condition, self.reasons
        if condition is Condition.FAILED:
            pass  # it stays so, whether it still reports or not
        elif self.ending:
            condition = Condition.ENDED
        elif age_s > silent_s:
            condition = Condition.SILENT
            why = f"{self.condition} before" + (f": {why}" if why else "")
        elif condition is Condition.EXPOSING and lost_share > TOO_MANY_LOST:
            condition, why = Condition.LOSING, self.lost_words
        return RigLine(rig, condition, why, age_s, self.rate_hz, self.counts[-1][2], lost_share, self.setting)

    @property
    def lost_share(self) -> float:
        (_, pairs_before, lost_before), (_, pairs, lost) = self.counts[0], self.counts[-1]
        triggers = pairs - pairs_before + lost - lost_before
        return (lost - lost_before) / triggers if triggers else 0.0

    def _count(self, now_s: float, pairs: int, lost: int) -> None:
        counts = self.counts
        if counts and (pairs < counts[-1][1] or lost < counts[-1][2]):
            counts.clear()  # it has opened its cameras again
        if len(counts) > 1 and now_s - counts[-2][0] < _SAMPLE_S:
            counts.pop()
        counts.append((now_s, pairs, lost))
        while now_s - counts[0][0] > _RECENT_S:
            counts.popleft()


class Fleet:
    """All rigs heard so far; callable on any thread. A rig that has said nothing for `silent_s` is silent."""

    def __init__(self, silent_s: float = SILENT_S) -> None:
        self._silent_s = silent_s
        self._rigs: dict[str, _Rig] = {}
        self._turned_away_s = -math.inf
        self._lock = threading.Lock()

    def take(self, rig: str, status: Status, now_s: float) -> bool:
        """Note a status that arrived under the key of a rig, and return whether the rig is listed.

        A status that names a different rig than its key does not come from a daemon, and is ignored.
        """
        if status.rig != rig or len(rig) > _LONGEST_NAME or not RIG_NAME.fullmatch(rig):
            return False
        with self._lock:
            if rig not in self._rigs and len(self._rigs) >= MOST_RIGS:
                self._turned_away_s = now_s
                return False
            self._rigs.setdefault(rig, _Rig()).take(status, now_s)
            return True

    def lines(self, now_s: float) -> Sequence[RigLine]:
        """Every rig, worst first: by `Condition`, then by the share of triggers lost, then by name."""
        with self._lock:
            lines = [known.line(rig, now_s, self._silent_s) for rig, known in self._rigs.items()]
        return sorted(lines, key=lambda line: (_RANKS[line.condition], -line.lost_share, line.rig))

    def crowded(self, now_s: float) -> bool:
        """Whether some of the rigs that report at present are not listed, for lack of room."""
        return now_s - self._turned_away_s < _CROWDED_S


_FLEET_MESSAGES = 64
_LOOK_S = 1.0


class FleetClient:
    """Follows the statuses of all rigs, while its context is entered.

    It waits for daemons and routers that are not running, and finds them again. Each endpoint has a session of its
    own: given several endpoints, a zenoh client talks to only one of them. `connect` None: to the sockets of all rigs
    on this machine, also those that appear meanwhile. `heard` is set once there is a rig.
    """

    def __init__(
        self, connect: Sequence[str] | None = None, zenoh_file: Path | None = None, silent_s: float = SILENT_S
    ) -> None:
        self.fleet = Fleet(silent_s)
        self.heard = threading.Event()
        self._troubles: dict[str, str] = {}
        self._holders: dict[str, SessionHolder] = {}
        self._ended = threading.Event()
        self._search = threading.Thread(target=self._look_for_sockets, name="sockets", daemon=True)
        self._searches = connect is None and zenoh_file is None
        if zenoh_file is not None:
            self._add(str(zenoh_file), Endpoints(file=zenoh_file))
        else:
            for endpoint in connect or ():
                self._add(endpoint, Endpoints(connect=(endpoint,)))

    @property
    def places(self) -> Sequence[str]:
        """Where it looks for rigs."""
        return list(self._troubles)

    @property
    def unanswered(self) -> Sequence[str]:
        """Places that have not answered since this client was entered."""
        if self._searches and not self._troubles:
            return searched()
        return [place for place, trouble in self._troubles.copy().items() if trouble]

    def __enter__(self) -> Self:
        for holder in self._holders.values():
            holder.start()
        if self._searches:
            self._search.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._searches:
            self._search.join()
        for holder in self._holders.values():
            holder.closed.set()
        for holder in self._holders.values():
            holder.close()

    def _look_for_sockets(self) -> None:
        while True:
            for endpoint in found_endpoints():
                if endpoint not in self._holders:
                    self._add(endpoint, Endpoints(connect=(endpoint,)))
                    self._holders[endpoint].start()
            if self._ended.wait(_LOOK_S):
                return

    def _add(self, place: str, endpoints: Endpoints) -> None:
        self._troubles[place] = "not connected yet"
        self._holders[place] = self._holder(place, endpoints)

    def _holder(self, place: str, endpoints: Endpoints) -> SessionHolder:
        def serve(session: zenoh.Session) -> None:
            holder.subscribe(session, rig_key("*", "status"), self._take, _FLEET_MESSAGES, LARGEST_STATUS_BYTES)
            holder.closed.wait()

        def on_trouble(trouble: str) -> None:
            self._troubles[place] = trouble

        holder = SessionHolder("client", endpoints, serve, on_trouble)
        return holder

    def _take(self, key: str, data: bytes) -> None:
        status = Status.from_json(data)
        if status is not None and self.fleet.take(last_but(key, 1), status, time.monotonic()):
            self.heard.set()
