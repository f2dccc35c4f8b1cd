"""Faults on order: what a cable, a switch or a camera may do wrong, counted in triggers."""

from __future__ import annotations

import json
import random
import reprlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum


class Fault(str, Enum):
    """What can go wrong, by the name that an order gives it.

    ``delay``             the frames of `count` triggers are sent 0.2 s late, and no frame overtakes them
    ``freeze``            the frames of `count` triggers are taken but not sent; the control channel answers
    ``vanish``            cable and power are out for `count` triggers, or until ``come_back`` if `count` is None
    ``come_back``         the camera is back, in its power-on state
    ``refuse_writes``     `count` writes are answered with an access error
    ``stick``             `count` writes are acknowledged and change nothing
    ``shrink``            `count` writes of numbers are acknowledged but take 5 % less, within the limits
    ``ignore_triggers``   `count` triggers make no frame, and the frame id does not advance
    ``stop_triggers``     `count` pulses do not rise, nor do they appear in the truth
    ``halve_triggers``    of `count` triggers those with odd numbers make no frame
    ``double_triggers``   each of `count` triggers is followed by another pulse half a period later
    ``freeze_exposure``   `count` triggers are exposed like the one before them, whatever was written
    ``black``, ``white``  the images of `count` triggers are uniform: 0 or full scale
    ``clock_ahead``, ``clock_back``  at each of `count` triggers the device's clock jumps by 10 s (never below 0)
    ``zero_stamps``, ``still_stamps``  the time stamps of `count` triggers' frames are 0, or that of the one before
    ``microseconds``      the time stamps of `count` triggers' frames are in us, not in ns
    ``wrap_stamps``       during `count` triggers time stamps, and the clock as latched, have their lower 32 bits only
    ``zero_counter``      the frame ids of `count` triggers are 0
    ``restart_counter``   at each of `count` triggers frame ids begin at 1 again
    ``skip_counter``      during `count` triggers every tenth frame id is followed by that 4 higher
    ``double_counter``    during `count` triggers frame ids go on by 2
    ``truncate``          `count` frames end halfway through their payload
    ``big_endian``        the samples of two bytes of `count` triggers' images are sent with the high byte first
    ``no_chunks``         `count` frames come without chunk data
    ``nan_chunks``        the chunk data of `count` frames give NaN as exposure time and gain

    GigE Vision only:

    ``no_ticks``          during `count` triggers the tick frequency reads 0
    ``late_actions``      `count` scheduled action commands come too late, and act 50 ms after their time
    ``lose_actions``      `count` action commands do not arrive
    ``lose_packets``      `count` stream packets are not sent, from the next trigger's frame on
    ``lose_half``         the same, but every other packet on average gets through
    ``other_address``     `count` stream packets leave from an address that is none of the camera's
    ``fragment``          `count` stream packets that are too large are sent in fragments, even if that is forbidden

    USB3 Vision only:

    ``nak``                  `count` commands are never taken: the host's transfer waits until the host gives up
    ``pending_acknowledge``  `count` commands are answered 0.1 s late, after a pending acknowledge
    ``stall``                the stream endpoint halts in place of each of `count` frames, until the host clears it
    ``short_trailer``        `count` frames have a trailer of 8 bytes
    """

    __str__ = str.__str__

    DELAY = "delay"
    FREEZE = "freeze"
    VANISH = "vanish"
    COME_BACK = "come_back"
    REFUSE_WRITES = "refuse_writes"
    STICK = "stick"
    SHRINK = "shrink"
    IGNORE_TRIGGERS = "ignore_triggers"
    STOP_TRIGGERS = "stop_triggers"
    HALVE_TRIGGERS = "halve_triggers"
    DOUBLE_TRIGGERS = "double_triggers"
    FREEZE_EXPOSURE = "freeze_exposure"
    BLACK = "black"
    WHITE = "white"
    CLOCK_AHEAD = "clock_ahead"
    CLOCK_BACK = "clock_back"
    ZERO_STAMPS = "zero_stamps"
    STILL_STAMPS = "still_stamps"
    MICROSECONDS = "microseconds"
    WRAP_STAMPS = "wrap_stamps"
    ZERO_COUNTER = "zero_counter"
    RESTART_COUNTER = "restart_counter"
    SKIP_COUNTER = "skip_counter"
    DOUBLE_COUNTER = "double_counter"
    NO_TICKS = "no_ticks"
    BIG_ENDIAN = "big_endian"
    TRUNCATE = "truncate"
    NO_CHUNKS = "no_chunks"
    NAN_CHUNKS = "nan_chunks"
    LATE_ACTIONS = "late_actions"
    LOSE_ACTIONS = "lose_actions"
    LOSE_PACKETS = "lose_packets"
    LOSE_HALF = "lose_half"
    OTHER_ADDRESS = "other_address"
    FRAGMENT = "fragment"
    NAK = "nak"
    PENDING_ACKNOWLEDGE = "pending_acknowledge"
    STALL = "stall"
    SHORT_TRAILER = "short_trailer"


PER_TRIGGER = frozenset(
    {
        *(Fault.FREEZE, Fault.DELAY, Fault.VANISH, Fault.FREEZE_EXPOSURE, Fault.BLACK, Fault.WHITE),
        Fault.BIG_ENDIAN,
        *(Fault.STOP_TRIGGERS, Fault.IGNORE_TRIGGERS, Fault.HALVE_TRIGGERS, Fault.DOUBLE_TRIGGERS),
        *(Fault.CLOCK_AHEAD, Fault.CLOCK_BACK, Fault.NO_TICKS),
        *(Fault.ZERO_STAMPS, Fault.STILL_STAMPS, Fault.MICROSECONDS, Fault.WRAP_STAMPS),
        *(Fault.ZERO_COUNTER, Fault.RESTART_COUNTER, Fault.SKIP_COUNTER, Fault.DOUBLE_COUNTER),
    }
)
"""Faults whose count is of triggers."""

_ALL = frozenset(Fault)

GIGE = _ALL - {Fault.NAK, Fault.PENDING_ACKNOWLEDGE, Fault.STALL, Fault.SHORT_TRAILER}
"""Faults of a GigE Vision camera."""

USB3 = _ALL - {
    *(Fault.LOSE_PACKETS, Fault.LOSE_HALF, Fault.OTHER_ADDRESS, Fault.FRAGMENT),
    *(Fault.LATE_ACTIONS, Fault.LOSE_ACTIONS, Fault.NO_TICKS),
}
"""Faults of a USB3 Vision camera."""

NOT_DESCRIBED = frozenset({Fault.NAN_CHUNKS, Fault.SHRINK})
"""Faults that a camera wearing a real one's description does not have."""

MOST_ORDERS = 1000
"""Orders that may wait or be in force at once: each trigger goes through all of them."""

DELAY_NS = 200_000_000
"""How late the frames of the fault ``delay`` are sent."""

JUMP_NS = 10_000_000_000
"""By how much ``clock_ahead`` and ``clock_back`` set the device's clock at each trigger that they meet."""

LATE_NS = 50_000_000
"""How long after its time an action of the fault ``late_actions`` acts."""

SHRUNK = 0.95
"""What the fault ``shrink`` multiplies written numbers by."""


_LAST_NUMBER = 10**15  # triggers: half a million years


class FaultError(Exception):
    """An order that is no fault; one sentence says why."""


@dataclass(frozen=True, slots=True)
class FaultOrder:
    """A fault, the trigger after which it begins (None: now) and how much of it (None: no end)."""

    fault: Fault
    after_trigger: int | None = None
    count: int | None = 1

    @classmethod
    def from_json(cls, line: str) -> FaultOrder:
        """The order in a line ``{"fault": NAME, "after_trigger": n or null, "count": n or null}``.

        Without a count it is 1, for ``vanish`` no end. Raises FaultError if the line is no JSON object, or a key, a
        name or a number in it is wrong.
        """
        try:
            order = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise FaultError(f"the line is not JSON: {error}") from None
        if not isinstance(order, dict):
            raise FaultError('the line must be a JSON object such as {"fault": "freeze", "count": 3}')
        for key in order.keys() - {"fault", "after_trigger", "count"}:
            raise FaultError(f"unknown key {reprlib.repr(key)}: the keys are fault, after_trigger and count")
        fault = _fault(order.get("fault"))
        count = _whole_number(order, "count", 1)
        if count is not None and fault is Fault.COME_BACK:
            raise FaultError("come_back has no count: leave it out")
        if count is None and fault is not Fault.VANISH:
            count = 1
        return cls(fault, _whole_number(order, "after_trigger", 0), count)


def _fault(name: object) -> Fault:
    if isinstance(name, str) and name in _ALL:
        return Fault(name)
    raise FaultError(f"unknown fault {reprlib.repr(name)}: the faults are {', '.join(sorted(_ALL))}")


def _whole_number(order: dict[str, object], key: str, minimum: int) -> int | None:
    value = order.get(key)
    if value is None:
        return None
    if not isinstance(value, int) or isinstance(value, bool) or not minimum <= value <= _LAST_NUMBER:
        given = reprlib.repr(value)
        raise FaultError(f"{key} must be a whole number from {minimum} to {_LAST_NUMBER} or null, not {given}")
    return value


@dataclass(slots=True, eq=False)
class _OpenOrder:
    fault: Fault
    after_trigger: int | None
    left: int | None

    def begun(self, trigger: int) -> bool:
        """Whether the fault reaches the trigger of this number."""
        return self.after_trigger is None or trigger > self.after_trigger


class Faults:
    """The faults in force; safe to use from any thread.

    The device itself carries out what concerns exposures: ``freeze``, ``delay`` and ``ignore_triggers`` show in the
    sink as frames that come late or not at all. The protocol asks for the others as it does what they spoil.

    `power_off` is called when the camera vanishes, `power_on` before a vanished camera answers again.
    """

    def __init__(
        self, power_on: Callable[[], None] = lambda: None, power_off: Callable[[], None] = lambda: None
    ) -> None:
        self._power_on = power_on
        self._power_off = power_off
        self._gone = False
        self._allowed = _ALL
        self._lock = threading.Lock()
        self._restart = threading.Lock()  # held while the camera restarts
        self._orders: list[_OpenOrder] = []
        self._trigger = -1  # the last pulse of Line0
        self._sent = -1  # the last pulse before the exposure of the frame that is being sent
        self._coin = random.Random(0)

    def restrict(self, faults: frozenset[Fault]) -> None:
        """Refuse all other faults: a transport knows only its own."""
        self._allowed = faults

    def add(self, order: FaultOrder) -> int:
        """Take an order; returns the number of the last trigger before it (-1 before the first).

        Raises FaultError if this camera cannot have the fault, or too many orders wait.
        """
        if order.fault not in self._allowed:
            names = ", ".join(sorted(self._allowed))
            raise FaultError(f"this camera cannot have the fault {order.fault}: its faults are {names}")
        with self._lock:
            at_once = order.fault is Fault.COME_BACK and order.after_trigger is None
            if len(self._orders) >= MOST_ORDERS and not at_once:
                raise FaultError(f"{MOST_ORDERS} orders wait or are in force: wait until some are over")
            self._orders.append(_OpenOrder(order.fault, order.after_trigger, order.count))
            trigger = self._trigger
        self._come_back(trigger)
        self._go_away()
        return trigger

    def on_trigger(self, trigger: int) -> frozenset[Fault]:
        """Count a pulse of Line0; the faults in `PER_TRIGGER` that it meets."""
        self._come_back(trigger)
        with self._lock:
            self._trigger = trigger
            met = [order for order in self._orders if order.fault in PER_TRIGGER and order.begun(trigger)]
            for order in met:
                if order.left is not None:
                    order.left -= 1
            self._orders = [order for order in self._orders if order.left != 0 or order.fault is Fault.VANISH]
        self._go_away()
        return frozenset(order.fault for order in met)

    def on_send(self, trigger: int) -> None:
        """Note that the frame of a trigger (or of an exposure after it) is sent now."""
        with self._lock:
            self._sent = trigger

    @property
    def vanished(self) -> bool:
        """Whether the camera is off the wire: answer nothing and send nothing."""
        with self._lock:
            return self._vanished()

    def in_force(self, fault: Fault) -> bool:
        """Whether a fault in `PER_TRIGGER` meets the triggers of the present."""
        with self._lock:
            return any(order.fault is fault and order.begun(self._trigger) for order in self._orders)

    def lose_packet(self) -> bool:
        """Whether the stream packet about to be sent is to be lost; asked once for each packet."""
        if self.spoils_packet(Fault.LOSE_PACKETS):
            return True
        return bool(self._orders) and self._coin.random() < 0.5 and self.spoils_frame(Fault.LOSE_HALF)

    def spoils_packet(self, fault: Fault) -> bool:
        """Whether the stream packet about to be sent meets this fault; asked once for each packet."""
        # Nearly always there are no orders, and a frame has dozens of packets.
        return bool(self._orders) and self.spoils_frame(fault)

    def spoils_frame(self, fault: Fault) -> bool:
        """Whether the frame that is being sent meets this fault; asked once for each unit that the fault counts."""
        with self._lock:
            return self._spend(fault, self._sent)

    def spoils_command(self, fault: Fault) -> bool:
        """Whether the command just received meets this fault; asked once for each."""
        with self._lock:
            return self._spend(fault, self._trigger)

    def _spend(self, fault: Fault, trigger: int) -> bool:
        for order in self._orders:
            if order.fault is fault and order.left is not None and order.begun(trigger):
                order.left -= 1
                if order.left == 0:
                    self._orders.remove(order)
                return True
        return False

    def _come_back(self, trigger: int) -> None:
        """End the absences that are over by `trigger`; the camera restarts, once, before it answers again."""
        with self._restart:
            with self._lock:
                called = [order for order in self._orders if order.fault is Fault.COME_BACK and order.begun(trigger)]
                over = [
                    order
                    for order in self._orders
                    if order.fault is Fault.VANISH
                    and (called or (order.left == 0 and trigger > self._trigger))
                    and order.begun(trigger)
                ]
            if over:
                self._power_on()
            with self._lock:
                self._orders = [order for order in self._orders if order not in called and order not in over]
                self._gone = self._gone and not over

    def _go_away(self) -> None:
        with self._lock:
            goes = self._vanished() and not self._gone
            self._gone = self._gone or goes
        if goes:
            self._power_off()

    def _vanished(self) -> bool:
        return any(order.fault is Fault.VANISH and order.begun(self._trigger) for order in self._orders)
