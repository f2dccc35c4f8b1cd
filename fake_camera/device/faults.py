"""Faults on order: what a cable, a switch or a camera may do wrong, counted in triggers."""

from __future__ import annotations

import json
import random
import reprlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

OF_THE_WIRE = frozenset({"double_triggers", "halve_triggers", "ignore_triggers", "stop_triggers"})
OF_THE_SENSOR = frozenset({"black", "freeze_exposure", "white"})
OF_THE_CLOCK = frozenset({"clock_ahead", "clock_back"})

PER_TRIGGER = frozenset({"freeze", "delay", "vanish"}) | OF_THE_WIRE | OF_THE_SENSOR | OF_THE_CLOCK
"""Faults whose count is of triggers."""

_ANYWHERE = frozenset({"come_back", "nan_chunks", "no_chunks", "refuse_writes", "shrink", "stick", "truncate"})
_ANYWHERE |= PER_TRIGGER

GIGE = frozenset({"lose_half", "lose_packets"}) | _ANYWHERE
"""Faults of a GigE Vision camera."""

USB3 = frozenset({"nak", "pending_acknowledge", "short_trailer", "stall"}) | _ANYWHERE
"""Faults of a USB3 Vision camera."""

NOT_DESCRIBED = frozenset({"nan_chunks", "shrink"})
"""Faults that a camera in the description of a real one does not know."""

NAMES = GIGE | USB3
"""All faults there are."""

MOST_ORDERS = 1000
"""Orders that may wait or be in force at once: each trigger looks at all of them."""

DELAY_NS = 200_000_000
"""How late the frames of the fault ``delay`` are sent."""

JUMP_NS = 10_000_000_000
"""By how much ``clock_ahead`` and ``clock_back`` set the device's clock at each trigger that they meet."""

SHRUNK = 0.95
"""The part of a number that is taken of a write that meets ``shrink``."""


_LAST_NUMBER = 10**15  # triggers: half a million years


class FaultError(Exception):
    """An order that is no fault; one sentence says why."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One order: a fault, the trigger after which it begins (None: now) and how much of it.

    ``delay``             the frames of `count` triggers are sent 0.2 s late, and no frame overtakes them
    ``freeze``            the frames of `count` triggers are taken but not sent; the control channel answers
    ``vanish``            cable and power are out for `count` triggers, or until ``come_back`` when it is None
    ``come_back``         the camera is there again, in its power-on state
    ``refuse_writes``     `count` writes are answered with an access error
    ``stick``             `count` writes are acknowledged and change nothing
    ``shrink``            `count` writes of numbers are acknowledged, and 5 % less is taken, within its limits
    ``ignore_triggers``   `count` triggers make no frame, and the frame id does not advance
    ``stop_triggers``     `count` pulses do not rise: they are not in the truth either
    ``halve_triggers``    of `count` triggers those with odd numbers make no frame
    ``double_triggers``   each of `count` triggers is followed by another pulse half a period later
    ``freeze_exposure``   `count` triggers are exposed as the one before them, whatever was written
    ``black``, ``white``  the images of `count` triggers are even, 0 or full scale
    ``clock_ahead``, ``clock_back``  at each of `count` triggers the device's clock jumps by 10 s (never below 0)
    ``truncate``          `count` frames end halfway through their payload
    ``no_chunks``         `count` frames come without chunk data
    ``nan_chunks``        the chunk data of `count` frames tell no numbers (NaN) for exposure time and gain

    Of GigE Vision only:

    ``lose_packets``      `count` stream packets are not sent, from the next trigger's frame on
    ``lose_half``         the same, but of every two packets one goes through, on average

    Of USB3 Vision only:

    ``nak``                  `count` commands are never taken: the host's transfer waits until the host gives up
    ``pending_acknowledge``  `count` commands are answered 0.1 s late, after a pending acknowledge
    ``stall``                the stream endpoint halts in place of each of `count` frames, until the host clears it
    ``short_trailer``        `count` frames have a trailer of 8 bytes
    """

    name: str
    after_trigger: int | None = None
    count: int | None = 1

    @classmethod
    def from_json(cls, line: str) -> Self:
        """The order in a line ``{"fault": NAME, "after_trigger": n or null, "count": n or null}``.

        Without a count it is 1, for ``vanish`` no end.

        Raises
        ------
        FaultError
            The line is no JSON object, or a key, a name or a number in it is wrong.
        """
        try:
            order = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise FaultError(f"the line is not JSON: {error}") from None
        if not isinstance(order, dict):
            raise FaultError('the line must be a JSON object such as {"fault": "freeze", "count": 3}')
        for key in order.keys() - {"fault", "after_trigger", "count"}:
            raise FaultError(f"unknown key {reprlib.repr(key)}: the keys are fault, after_trigger and count")
        name = order.get("fault")
        if not isinstance(name, str) or name not in NAMES:
            raise FaultError(f"unknown fault {reprlib.repr(name)}: the faults are {', '.join(sorted(NAMES))}")
        count = _whole_number(order, "count", 1)
        if count is not None and name == "come_back":
            raise FaultError("come_back has no count: leave it out")
        if count is None and name != "vanish":
            count = 1
        return cls(name, _whole_number(order, "after_trigger", 0), count)


def _whole_number(order: dict[str, object], key: str, minimum: int) -> int | None:
    value = order.get(key)
    if value is None:
        return None
    if not isinstance(value, int) or isinstance(value, bool) or not minimum <= value <= _LAST_NUMBER:
        told = reprlib.repr(value)
        raise FaultError(f"{key} must be a whole number from {minimum} to {_LAST_NUMBER} or null, not {told}")
    return value


@dataclass(slots=True, eq=False)
class _Order:
    fault: Fault
    left: int | None

    def begun(self, trigger: int) -> bool:
        """Whether the fault reaches the trigger of this number."""
        return self.fault.after_trigger is None or trigger > self.fault.after_trigger


class Faults:
    """The faults in force; safe to use from any thread.

    The device itself does what concerns exposures: ``freeze``, ``delay`` and ``ignore_triggers`` show in the sink as
    frames that do not come or come late. The protocol asks for the others when it does what they spoil.

    `power_off` is called when the camera vanishes, `power_on` before a vanished camera answers again.
    """

    def __init__(
        self, power_on: Callable[[], None] = lambda: None, power_off: Callable[[], None] = lambda: None
    ) -> None:
        self._power_on = power_on
        self._power_off = power_off
        self._gone = False
        self._names = NAMES
        self._lock = threading.Lock()
        self._restart = threading.Lock()  # held while the camera restarts
        self._orders: list[_Order] = []
        self._trigger = -1  # the last pulse of Line0
        self._sent = -1  # the last pulse before the exposure of the frame that is being sent
        self._coin = random.Random(0)

    def restrict(self, names: frozenset[str]) -> None:
        """Refuse all faults but those of `names`: a transport knows only its own."""
        self._names = names

    def add(self, fault: Fault) -> int:
        """Order a fault; the answer is the number of the last trigger before it (-1 before the first).

        Raises
        ------
        FaultError
            The camera's transport has no such fault, or too many orders wait.
        """
        if fault.name not in self._names:
            names = ", ".join(sorted(self._names))
            raise FaultError(f"{fault.name} is no fault of this camera's transport: its faults are {names}")
        with self._lock:
            at_once = fault.name == "come_back" and fault.after_trigger is None
            if len(self._orders) >= MOST_ORDERS and not at_once:
                raise FaultError(f"{MOST_ORDERS} orders wait or are in force: let some be over first")
            self._orders.append(_Order(fault, fault.count))
            trigger = self._trigger
        self._come_back(trigger)
        self._go_away()
        return trigger

    def on_trigger(self, trigger: int) -> frozenset[str]:
        """Count a pulse of Line0; the names of the faults in `PER_TRIGGER` that it meets."""
        self._come_back(trigger)
        with self._lock:
            self._trigger = trigger
            met = [order for order in self._orders if order.fault.name in PER_TRIGGER and order.begun(trigger)]
            for order in met:
                if order.left is not None:
                    order.left -= 1
            self._orders = [order for order in self._orders if order.left != 0 or order.fault.name == "vanish"]
        self._go_away()
        return frozenset(order.fault.name for order in met)

    def on_send(self, trigger: int) -> None:
        """Note that the frame of a trigger (or of an exposure after it) is sent now."""
        with self._lock:
            self._sent = trigger

    @property
    def vanished(self) -> bool:
        """Whether the camera is off the wire: answer nothing and send nothing."""
        with self._lock:
            return self._vanished()

    def lose_packet(self) -> bool:
        """Whether the stream packet about to be sent is to be lost; asked once for each packet."""
        if not self._orders:  # as a rule: a frame has dozens of packets
            return False
        return self.spoils_frame("lose_packets") or (self._coin.random() < 0.5 and self.spoils_frame("lose_half"))

    def spoils_frame(self, name: str) -> bool:
        """Whether the frame that is being sent meets this fault; asked once for each unit that the fault counts."""
        with self._lock:
            return self._spend(name, self._sent)

    def spoils_command(self, name: str) -> bool:
        """Whether the command just received meets this fault; asked once for each."""
        with self._lock:
            return self._spend(name, self._trigger)

    def refuse_write(self) -> bool:
        """Whether the write just received is to be answered with an access error; asked once for each write."""
        return self.spoils_command("refuse_writes")

    def _spend(self, name: str, trigger: int) -> bool:
        for order in self._orders:
            if order.fault.name == name and order.left is not None and order.begun(trigger):
                order.left -= 1
                if order.left == 0:
                    self._orders.remove(order)
                return True
        return False

    def _come_back(self, trigger: int) -> None:
        """End the absences that are over by `trigger`; the camera restarts, once, before it answers again."""
        with self._restart:
            with self._lock:
                called = [order for order in self._orders if order.fault.name == "come_back" and order.begun(trigger)]
                over = [
                    order
                    for order in self._orders
                    if order.fault.name == "vanish"
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
        return any(order.fault.name == "vanish" and order.begun(self._trigger) for order in self._orders)
