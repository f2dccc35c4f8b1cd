"""Which trigger makes which exposure: a pure state machine; the caller passes in the time, and there is no thread."""

from __future__ import annotations

from dataclasses import dataclass

from fake_camera.device.faults import Fault
from fake_camera.device.features import Features, readout_ns
from fake_camera.imaging import ImageSettings


@dataclass(frozen=True, slots=True)
class Exposure:
    """An exposure that has started; times are CLOCK_MONOTONIC.

    `ready_ns` is the end of its readout, `pulse` the last pulse of Line0 before or at its start, `trigger` the same if
    that pulse started it, `run` numbers the acquisitions, and `faults` are those that its trigger met.
    """

    run: int
    frame_id: int
    trigger: int | None
    pulse: int
    start_ns: int
    ready_ns: int
    settings: ImageSettings
    faults: frozenset[Fault]


@dataclass(slots=True)
class Counters:
    """What became of the triggers: pulses seen, exposures made, and why the others were not made or not sent.

    `dropped` triggers came during exposure or readout, `ignored` ones met a fault, and `missed` ones are those that
    their thread was too late for; `overruns` are exposures that were too late to send, `discarded` ones those that
    found the camera's memory full because the host had not fetched earlier frames.
    """

    pulses: int = 0
    exposures: int = 0
    dropped: int = 0
    ignored: int = 0
    missed: int = 0
    overruns: int = 0
    discarded: int = 0


class Acquisition:
    """Trigger mode, free run, latching and readout of one camera. Not thread-safe: its owner holds a lock."""

    def __init__(self, features: Features) -> None:
        self._features = features
        self._acquiring = False
        self._started_ns = 0
        self._frame_id = 0
        self._pulse = -1
        self._faults: frozenset[Fault] = frozenset()
        self._last_start_ns: int | None = None
        self._last_settings: ImageSettings | None = None
        self._free_since_ns: int | None = None
        self._exposure_end_ns = 0
        self._readout_start_ns = 0
        self._readout_end_ns = 0
        self.run = 0
        self.counters = Counters()

    def start(self, now_ns: int) -> None:
        """Begin to acquire, unless already acquiring; frame ids begin at 1."""
        if self._acquiring:
            return
        self._acquiring = True
        self.run += 1
        self._started_ns = now_ns
        self._frame_id = 0
        self._last_start_ns = None
        self._last_settings = None
        self._free_since_ns = None
        self._features.update("TLParamsLocked", 1)

    def stop(self) -> None:
        """End the acquisition: exposures of this `run` are no longer to be sent."""
        self._end()
        self.run += 1

    def pulse(self, pulse: int, time_ns: int, faults: frozenset[Fault], wired: bool) -> Exposure | None:
        """Line0 has risen: the exposure it starts, if the camera is wired to it, waits for it and is ready for it."""
        self.counters.pulses += 1
        self._pulse = pulse
        self._faults = faults
        if not (wired and self._waits_for("Line0")) or time_ns < self._started_ns or Fault.VANISH in faults:
            return None
        if Fault.IGNORE_TRIGGERS in faults or (Fault.HALVE_TRIGGERS in faults and pulse % 2):
            self.counters.ignored += 1
            return None
        return self._triggered(time_ns, pulse)

    def echo(self, time_ns: int, wired: bool) -> Exposure | None:
        """Line0 has risen between two of its pulses: the exposure it starts, if the camera is ready for it."""
        return self._triggered(time_ns, None) if wired and self._waits_for("Line0") else None

    def signal(self, source: str, time_ns: int) -> Exposure | None:
        """Line3, Action1 or Software: the exposure it starts, if the camera waits for it and is ready for it."""
        if not self._waits_for(source) or time_ns < self._started_ns or Fault.VANISH in self._faults:
            return None
        if Fault.IGNORE_TRIGGERS in self._faults:
            self.counters.ignored += 1
            return None
        return self._triggered(time_ns, None)

    def software_trigger(self, time_ns: int) -> Exposure | None:
        """TriggerSoftware: the exposure it starts, if the camera waits for it and is ready for it."""
        return self.signal("Software", time_ns)

    def free_run_start_ns(self, now_ns: int) -> int | None:
        """When the next exposure of the free run starts; None when the camera is not running freely."""
        if not self._acquiring or self._features.get("TriggerMode") != "Off":
            self._free_since_ns = None
            return None
        if self._free_since_ns is None:
            self._free_since_ns = now_ns
        exposure_ns = round(float(self._features.get("ExposureTime")) * 1e3)
        ready_ns = max(self._free_since_ns, self._exposure_end_ns, self._readout_end_ns - exposure_ns)
        if self._last_start_ns is None or not self._features.get("AcquisitionFrameRateEnable"):
            return ready_ns
        period_ns = round(1e9 / float(self._features.get("AcquisitionFrameRate")))
        return max(ready_ns, self._last_start_ns + period_ns)

    def free_run(self, time_ns: int) -> Exposure:
        """Start the exposure that was due at `time_ns`."""
        return self._expose(time_ns, None)

    def _waits_for(self, source: str) -> bool:
        return (
            self._acquiring
            and self._features.get("TriggerMode") == "On"
            and self._features.get("TriggerSource") == source
        )

    def _triggered(self, time_ns: int, pulse: int | None) -> Exposure | None:
        overlap = self._features.get("TriggerOverlap") == "ReadOut"
        # With overlap one image may be read out while the next is exposed, but no third may wait behind these two.
        ready_ns = max(self._exposure_end_ns, self._readout_start_ns) if overlap else self._readout_end_ns
        if time_ns < ready_ns:
            self.counters.dropped += 1
            return None
        return self._expose(time_ns, pulse)

    def _expose(self, start_ns: int, trigger: int | None) -> Exposure:
        settings = self._features.image_settings(start_ns)
        if Fault.FREEZE_EXPOSURE in self._faults and self._last_settings is not None:
            settings = self._last_settings
        self._last_start_ns, self._last_settings = start_ns, settings
        self._exposure_end_ns = start_ns + round(settings.exposure_time_us * 1e3)
        self._readout_start_ns = max(self._exposure_end_ns, self._readout_end_ns)
        self._readout_end_ns = self._readout_start_ns + readout_ns(settings, int(self._features.get("SensorHeight")))
        self._frame_id = _next_frame_id(self._frame_id, self._faults)
        self.counters.exposures += 1
        exposure = Exposure(
            self.run, self._frame_id, trigger, self._pulse, start_ns, self._readout_end_ns, settings, self._faults
        )
        if self._features.get("AcquisitionMode") == "SingleFrame":
            self._end()
        return exposure

    def _end(self) -> None:
        self._acquiring = False
        self._features.update("TLParamsLocked", 0)


def _next_frame_id(frame_id: int, faults: frozenset[Fault]) -> int:
    if Fault.RESTART_COUNTER in faults:
        return 1
    if Fault.SKIP_COUNTER in faults and frame_id % 10 == 0:
        return frame_id + 4
    return frame_id + (2 if Fault.DOUBLE_COUNTER in faults else 1)
