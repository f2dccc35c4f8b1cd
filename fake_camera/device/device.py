"""A camera behind any protocol: the threads that take and send its images, and its clock."""

from __future__ import annotations

import os
import random
import threading
import time
import zlib
from collections.abc import Callable
from queue import SimpleQueue

import numpy as np

from fake_camera.device.acquisition import Acquisition, Counters, Exposure
from fake_camera.device.actions import ActionOutcome, Actions
from fake_camera.device.faults import DELAY_NS, JUMP_NS, LATE_NS, Fault, Faults
from fake_camera.device.features import Features
from fake_camera.device.line0 import Line0
from fake_camera.device.truth import TruthFile
from fake_camera.imaging import PIXEL_FORMATS, ExposedFrame, ImageSource, Pixels
from fake_camera.ptp.clock import Clock
from fake_camera.ptp.messages import PortIdentity
from fake_camera.ptp.slave import Slave

_TOO_LATE_NS = 500_000_000  # a pulse this old (the process was stopped) makes no exposure
_OVERRUN_NS = 100_000_000  # a frame that would be sent this late is dropped, so that a slow machine keeps up ...
_OVERRUN_PX = 720 * 540  # ... a larger one in proportion, and any by the time since the last, up to _TOO_LATE_NS
_DRIFT_PPM = 10.0
_PTP_DRIFT_PPM = 100.0  # what Ethernet allows a crystal
_UNWIRED_RATE_HZ = 60.0  # of the pulses by which faults and truth are counted when no wire is plugged in


class Device:
    """One camera: one thread follows wire and clock and starts exposures, one renders, one sends when they are due.

    `line0` is the wire plugged in; without one the camera can only run free or be triggered by software. `seed` and
    `serial` determine its clock's offset and drift and the noise of its images. Rendering yields to other threads by
    `niceness`, since a real sensor uses no processor time of the host (though a busy host would not slow it either).
    With `ptp_clock` (EUI-64) it has a PTP clock of this identity and takes action commands.

    Attributes
    ----------
    features
        Its features.
    faults
        The faults ordered for it.
    ptp
        Its PTP port, for the network to connect; None if it has none.
    """

    def __init__(
        self,
        source: ImageSource,
        serial: str,
        seed: int = 0,
        line0: Line0 | None = None,
        truth: TruthFile | None = None,
        *,
        model: str = "FakeGV287M",
        pixel_format: str = "Mono8",
        niceness: int = 0,
        ptp_clock: int | None = None,
    ) -> None:
        self._source = source
        self._niceness = niceness
        self._identity = f"{seed} {serial}"
        self._wired = line0 is not None
        self._still_ns = 0  # the last time stamp that was the clock's
        self._echo_ns: int | None = None  # when a pulse rises between two of the wire's
        self._line0 = line0 or Line0(time.monotonic_ns(), _UNWIRED_RATE_HZ)
        self._truth = truth
        oscillator = random.Random(self._identity)
        self._clock_start_ns = oscillator.randrange(1_000_000_000, 10_000_000_000)
        drift_ppm = oscillator.uniform(-1.0, 1.0) * (_DRIFT_PPM if ptp_clock is None else _PTP_DRIFT_PPM)
        self._clock = Clock(time.monotonic_ns(), self._clock_start_ns, drift_ppm)
        size = source.sensor_width, source.sensor_height
        # Half as late, a frame is not even rendered: else all would be rendered, then dropped.
        self._overrun_ns = max(_OVERRUN_NS, size[0] * size[1] * _OVERRUN_NS // _OVERRUN_PX)
        self.features = Features(
            serial, *size, self.now_ns, model=model, pixel_format=pixel_format, ptp_clock=ptp_clock
        )
        self.ptp: Slave | None = None
        if ptp_clock is not None:
            self.ptp = Slave(self._clock, PortIdentity(ptp_clock), lambda: bool(self.features.get("PtpEnable")))
        self._actions = Actions(self._clock, self.ptp)
        self.faults = Faults(self._power_on, self._power_off)
        self._acquisition = Acquisition(self.features)
        self._lock = threading.Lock()  # guards acquisition and actions; never held while other code is called back
        self._sending = threading.Lock()  # held while a frame is sent
        self._sink: Callable[[ExposedFrame], None] = lambda frame: None
        self._exposure_ended: Callable[[ExposedFrame], None] = lambda frame: None
        self._on_power_on: list[Callable[[], None]] = []
        self._on_power_off: list[Callable[[], None]] = []
        self._show_exposure: Callable[[int], None] = lambda start_ns: None
        self._exposures: SimpleQueue[tuple[Exposure, int] | None] = SimpleQueue()
        self._frames: SimpleQueue[tuple[int, int, Exposure, ExposedFrame] | None] = SimpleQueue()
        self._wake = threading.Event()
        self._closed = threading.Event()
        self._threads = [
            threading.Thread(target=self._latch, name="latch", daemon=True),
            threading.Thread(target=self._take, name="take", daemon=True),
            threading.Thread(target=self._send, name="send", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def counters(self) -> Counters:
        """What became of the triggers so far."""
        return self._acquisition.counters

    def now_ns(self) -> int:
        """The device's own clock: since power-on, a few ppm off CLOCK_MONOTONIC, as real crystals are, or PTP's."""
        return max(self._clock.time_ns(time.monotonic_ns()), 0)

    def execute(self, command: str) -> None:
        """Run a command of the description (else KeyError), at any time.

        A software trigger that the camera is not waiting for is dropped. FeatureError when UserSetLoad or UserSetSave
        is refused.
        """
        match command:
            case "AcquisitionStart":
                with self._sending:  # a frame under way at the last stop is none of this acquisition
                    pass
                with self._lock:
                    self._acquisition.start(time.monotonic_ns())
                self._wake.set()
            case "AcquisitionStop":
                with self._lock:
                    self._acquisition.stop()
            case "TriggerSoftware":
                with self._lock:
                    self._start(self._acquisition.software_trigger(time.monotonic_ns()))
            case "TimestampLatch":
                bits = 0xFFFFFFFF if self.faults.in_force(Fault.WRAP_STAMPS) else -1
                self.features.update("TimestampLatchValue", self.now_ns() & bits)
            case "DeviceReset":
                self._power_on()
            case "UserSetLoad":
                self.features.load_user_set()
            case "UserSetSave":
                self.features.save_user_set()
            case "PtpDataSetLatch" if self.ptp is not None:
                self._latch_ptp(self.ptp)
            case _:
                raise KeyError(command)

    def connect(
        self,
        sink: Callable[[ExposedFrame], None],
        exposure_ended: Callable[[ExposedFrame], None] = lambda frame: None,
    ) -> None:
        """Pass each finished frame to `sink`, on the device's sending thread, where sending may take time.

        Before that, and while EventNotification is on, to `exposure_ended`, when its exposure ends; it must not wait.
        """
        self._sink = sink
        self._exposure_ended = exposure_ended

    def wire_line1(self, rise: Callable[[int], None]) -> None:
        """Call `rise` with the start of each exposure (CLOCK_MONOTONIC, ns) while Line1 shows it; it must not wait."""
        self._show_exposure = rise

    def line3_pulse(self, time_ns: int) -> None:
        """Line3 rises at `time_ns`, CLOCK_MONOTONIC; a pulse far from the present makes no exposure."""
        with self._lock:
            if abs(time.monotonic_ns() - time_ns) > _TOO_LATE_NS:
                self._acquisition.counters.missed += 1
                return
            self._start(self._acquisition.signal("Line3", time_ns))

    def action(self, time_ns: int | None) -> ActionOutcome:
        """Take an action command for `time_ns` on the device's clock, or for now: Action1 comes then."""
        with self._lock:
            now_ns = time.monotonic_ns()
            if time_ns is not None and self.faults.spoils_command(Fault.LATE_ACTIONS):
                self._actions.schedule(time_ns + LATE_NS)
                outcome = ActionOutcome.LATE
            else:
                outcome = self._actions.command(time_ns, now_ns)
                if outcome in (ActionOutcome.NOW, ActionOutcome.LATE):
                    self._start(self._acquisition.signal("Action1", now_ns))
        self._wake.set()
        return outcome

    def on_power_on(self, callback: Callable[[], None]) -> None:
        """Call `callback` when the camera restarts (DeviceReset, or back after vanishing): forget the client."""
        self._on_power_on.append(callback)

    def on_power_off(self, callback: Callable[[], None]) -> None:
        """Call `callback` when the camera vanishes."""
        self._on_power_off.append(callback)

    def close(self) -> None:
        """Stop the threads."""
        self._closed.set()
        self._wake.set()
        self._exposures.put(None)
        for thread in self._threads:
            thread.join()

    def _power_on(self) -> None:
        with self._lock:
            self._acquisition.stop()
            self._actions.clear()
            self.features.reset()
            now_ns = time.monotonic_ns()
            self._clock.set(self._clock_start_ns, now_ns)
            if self.ptp is not None:
                self.ptp.poll(now_ns)  # disabled, it forgets its master
        for callback in self._on_power_on:
            callback()

    def _power_off(self) -> None:
        with self._lock:
            self._acquisition.stop()
            self._actions.clear()
        for callback in self._on_power_off:
            callback()

    def _latch_ptp(self, ptp: Slave) -> None:
        data_set = ptp.data_set()
        self.features.update("PtpStatus", data_set.state.name)
        self.features.update("PtpServoStatus", "Locked" if data_set.locked else "Unknown")
        self.features.update("PtpOffsetFromMaster", data_set.offset_ns)
        self.features.update("PtpParentClockID", data_set.parent)
        self.features.update("PtpGrandmasterClockID", data_set.grandmaster)

    def _start(self, exposure: Exposure | None) -> None:
        if exposure is None or self.faults.vanished:
            return
        if self.features.shows_exposure:
            self._show_exposure(exposure.start_ns)
        device_time_ns = max(self._clock.time_ns(exposure.start_ns), 0)
        if self._truth is not None and exposure.trigger is None:
            self._truth.record_exposure(exposure, device_time_ns)
        self._exposures.put((exposure, self._stamp_ns(device_time_ns, exposure.faults)))

    def _stamp_ns(self, device_time_ns: int, faults: frozenset[Fault]) -> int:
        """What a frame says of its time."""
        if Fault.STILL_STAMPS not in faults:
            self._still_ns = device_time_ns
        if Fault.ZERO_STAMPS in faults:
            return 0
        if Fault.MICROSECONDS in faults:
            return device_time_ns // 1000
        return self._still_ns & 0xFFFFFFFF if Fault.WRAP_STAMPS in faults else self._still_ns

    def _latch(self) -> None:
        """Follow wire, free run and actions by their nominal times, so that delays of this thread do not show."""
        pulse = self._line0.first_pulse_after(time.monotonic_ns())
        while not self._closed.is_set():
            pulse_ns = self._line0.pulse_time_ns(pulse)
            now_ns = time.monotonic_ns()
            with self._lock:
                free_run_ns = self._acquisition.free_run_start_ns(now_ns)
                action_ns = self._actions.due_ns()
            times_ns = (pulse_ns, free_run_ns, self._echo_ns, action_ns)
            due_ns = min(time_ns for time_ns in times_ns if time_ns is not None)
            if now_ns < due_ns:
                self._wake.wait((due_ns - now_ns) * 1e-9)
                self._wake.clear()
            elif due_ns == pulse_ns:
                self._on_pulse(pulse, pulse_ns, now_ns)
                pulse += 1
            elif due_ns == self._echo_ns:
                self._echo_ns = None
                with self._lock:
                    self._start(self._acquisition.echo(due_ns, self._wired))
            elif due_ns == action_ns:
                self._on_action(now_ns)
            else:
                self._on_free_run(now_ns)

    def _on_pulse(self, pulse: int, pulse_ns: int, now_ns: int) -> None:
        faults = self.faults.on_trigger(pulse)
        if Fault.STOP_TRIGGERS in faults:
            return
        if self._truth is not None:
            self._truth.record(pulse)
        if Fault.CLOCK_AHEAD in faults:
            self._clock.set(self._clock.time_ns(now_ns) + JUMP_NS, now_ns)
        if Fault.CLOCK_BACK in faults:
            self._clock.set(max(self._clock.time_ns(now_ns) - JUMP_NS, 0), now_ns)
        if Fault.DOUBLE_TRIGGERS in faults:
            self._echo_ns = (pulse_ns + self._line0.pulse_time_ns(pulse + 1)) // 2
        with self._lock:
            if now_ns - pulse_ns > _TOO_LATE_NS:
                self._acquisition.counters.missed += 1
            else:
                self._start(self._acquisition.pulse(pulse, pulse_ns, faults, self._wired))

    def _on_action(self, now_ns: int) -> None:
        with self._lock:  # the camera may have been restarted meanwhile
            due_ns = self._actions.take(now_ns)
            if due_ns is None:
                return
            if now_ns - due_ns > _TOO_LATE_NS:
                self._acquisition.counters.missed += 1
            else:
                self._start(self._acquisition.signal("Action1", due_ns))

    def _on_free_run(self, now_ns: int) -> None:
        with self._lock:  # the acquisition may have been stopped or switched to triggers meanwhile
            start_ns = self._acquisition.free_run_start_ns(now_ns)
            if start_ns is not None and start_ns <= now_ns:
                in_time = now_ns - start_ns <= _TOO_LATE_NS
                self._start(self._acquisition.free_run(start_ns if in_time else now_ns))

    def _take(self) -> None:
        """Render each exposure during its exposure and readout, so that it is ready when it is due."""
        thread = threading.get_native_id()  # its niceness only, not that of the process
        os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + self._niceness)
        due_ns = last_start_ns = 0
        while (started := self._exposures.get()) is not None:
            exposure, device_time_ns = started
            tolerance_ns = max(self._overrun_ns, min(exposure.start_ns - last_start_ns, _TOO_LATE_NS))
            last_start_ns = exposure.start_ns
            # A delayed frame delays those behind it: frames stay in order.
            due_ns = max(due_ns, exposure.ready_ns + (DELAY_NS if Fault.DELAY in exposure.faults else 0))
            if (
                Fault.FREEZE not in exposure.faults
                and self._wanted(exposure)
                and self._in_time(due_ns, tolerance_ns // 2)
            ):
                self._frames.put((due_ns, tolerance_ns, exposure, self._render(exposure, device_time_ns)))
        self._frames.put(None)

    def _send(self) -> None:
        """Send each frame when it is due; sending takes as long as the transport needs."""
        while (rendered := self._frames.get()) is not None:
            due_ns, tolerance_ns, exposure, frame = rendered
            end_ns = exposure.start_ns + round(exposure.settings.exposure_time_us * 1e3)
            self._closed.wait(max(0, end_ns - time.monotonic_ns()) * 1e-9)
            if self.features.get("EventNotification") == "On" and self._wanted(exposure):
                self._exposure_ended(frame)
            if self._closed.wait(max(0, due_ns - time.monotonic_ns()) * 1e-9):
                return
            with self._sending:
                if self._wanted(exposure) and self._in_time(due_ns, tolerance_ns):
                    self.faults.on_send(exposure.pulse)
                    self._sink(frame)

    def _in_time(self, due_ns: int, tolerance_ns: int) -> bool:
        """Whether a frame due at that time is late by no more than this; if not, it is counted as an overrun."""
        if time.monotonic_ns() - due_ns <= tolerance_ns:
            return True
        self._acquisition.counters.overruns += 1
        return False

    def _wanted(self, exposure: Exposure) -> bool:
        return exposure.run == self._acquisition.run and not self.faults.vanished

    def _render(self, exposure: Exposure, device_time_ns: int) -> ExposedFrame:
        # Frame ids begin again with each acquisition, but noise does not.
        number = f"{exposure.run}.{exposure.frame_id}" if exposure.trigger is None else exposure.trigger
        noise_seed = zlib.crc32(f"{self._identity} {number}".encode())
        start_s = (exposure.start_ns - self._line0.epoch_ns) * 1e-9
        pixels = self._source.take(start_s, exposure.settings, noise_seed)
        pixels = _spoilt(pixels, exposure)
        frame_id = 0 if Fault.ZERO_COUNTER in exposure.faults else exposure.frame_id
        return ExposedFrame(frame_id, exposure.trigger, device_time_ns, pixels, exposure.settings)


def _spoilt(pixels: Pixels, exposure: Exposure) -> Pixels:
    """The image after the faults of the sensor."""
    pixel_format = PIXEL_FORMATS[exposure.settings.pixel_format]
    for fault, level in ((Fault.BLACK, 0), (Fault.WHITE, pixel_format.max_grey)):
        if fault in exposure.faults:
            pixels = np.full_like(pixels, level)
            if pixel_format.colours == "YUYV":
                pixels[..., 1] = 128  # chroma of grey
            break
    return pixels.byteswap() if Fault.BIG_ENDIAN in exposure.faults and not pixel_format.packing else pixels
