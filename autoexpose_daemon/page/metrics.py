"""A daemon's status for Prometheus; all names, and alerts: docs/look-up/metrics.md."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import attrgetter

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric, SummaryMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.registry import Collector

from autoexpose_daemon.status.counters import DURATIONS, TrackingRefusal, TrackingTally, counters
from autoexpose_daemon.status.document import (
    CameraStatus,
    DurationStatus,
    GroupStatus,
    PublishStatus,
    RecorderStatus,
    Status,
)
from autoexpose_daemon.status.states import State
from autoexpose_daemon.status.telemetry import DropReason
from drivers.triggers.outcomes import LossReason, missing
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName

CONTENT_TYPE = CONTENT_TYPE_PLAIN_0_0_4

_Values = float | Sequence[tuple[tuple[str, ...], float | None]] | None
"""A number, or several, each with its labels but the rig; None has no sample."""

_US_PER_S = 1e6
_MS_PER_S = 1e3


def exposition(rig: str, status: Status | None) -> bytes:
    """The metrics of a rig in Prometheus' text format, of type `CONTENT_TYPE`; without a status its daemon is down."""
    registry = CollectorRegistry()
    registry.register(_Collector(rig, status))
    return generate_latest(registry)


class _Collector(Collector):
    def __init__(self, rig: str, status: Status | None) -> None:
        self._rig = rig
        self._status = status

    def collect(self) -> Iterator[Metric]:
        status = self._status
        running = status is not None and not status.ending
        yield self._gauge("up", "Whether the daemon reports its status.", float(running))
        if status is None:
            return
        yield from self._condition(status)
        yield from self._groups(status.by_group)
        yield from self._cameras(status)
        yield from self._counts(status)
        yield from self._durations(status)
        if status.publishing is not None:
            yield from self._publishing(status.publishing)
        if status.recorder is not None:
            yield from self._recorder(status.recorder)
        if status.requests is not None:
            yield from self._requests(status.by_group)
        if status.tracking is not None:
            yield from self._tracking(status.tracking)

    def _condition(self, status: Status) -> Iterator[Metric]:
        states = [((state,), float(state is status.state)) for state in State]
        yield self._gauge("state", "1 for the state that the daemon is in.", states, "state")
        for name, help_text, value in (
            ("status_timestamp_seconds", "When the daemon last reported its status.", status.unix_time_s),
            ("uptime_seconds", "Time since the daemon started.", status.uptime_s),
            ("open_seconds", "Time since it opened its cameras; counters start there.", status.open_s),
        ):
            yield self._gauge(name, help_text, value)

    def _groups(self, groups: Mapping[str, GroupStatus]) -> Iterator[Metric]:
        policies = [((name, group.policy), 1.0) for name, group in groups.items()]
        yield self._gauge("policy", "1 for the policy that decides.", policies, "group", "policy")
        flickers = [((name,), group.flicker_hz) for name, group in groups.items()]
        yield self._gauge("flicker_hertz", "Flicker of the light that was found.", flickers, "group")
        decided = {name: group.decision for name, group in groups.items() if group.decision is not None}
        for name, help_text, figure_of in (
            ("image_metric", "The metric of the group's first camera, per pixel.", attrgetter("metric")),
            ("saturated_ratio", "Share of its pixels that are saturated.", attrgetter("saturated_share")),
            ("black_ratio", "Share of its pixels that are black.", attrgetter("black_share")),
        ):
            figures = [((group,), figure_of(decision)) for group, decision in decided.items()]
            yield self._gauge(name, help_text, figures, "group")

    def _cameras(self, status: Status) -> Iterator[Metric]:
        decided = {camera: group.decision for group in status.by_group.values() for camera in group.cameras}
        requested = {camera: decision.setting for camera, decision in decided.items() if decision is not None}
        cameras = status.cameras
        tables: list[tuple[str, str, Callable[[CameraName], float | None]]] = [
            ("camera_up", "Whether the camera is open.", lambda name: float(cameras[name].camera is not None)),
            (
                "requested_exposure_time_seconds",
                "Exposure time last decided on.",
                lambda name: _time_s(requested.get(name)),
            ),
            (
                "applied_exposure_time_seconds",
                "Exposure time of the newest frame.",
                lambda name: _time_s(cameras[name].applied),
            ),
            ("requested_gain_decibels", "Gain last decided on.", lambda name: _gain_db(requested.get(name))),
            ("applied_gain_decibels", "Gain of the newest frame.", lambda name: _gain_db(cameras[name].applied)),
            (
                "response_drift_grey_levels",
                "Error of the camera's response function.",
                lambda name: cameras[name].drift_grey,
            ),
            (
                "ptp_offset_seconds",
                "The camera's clock minus its PTP master's.",
                lambda name: _ptp_offset_s(cameras[name]),
            ),
            (
                "calibration_misfit",
                "Whether the camera's calibration does not fit.",
                lambda name: float(cameras[name].misfit is not None),
            ),
        ]
        for name, help_text, value_of in tables:
            yield self._gauge(name, help_text, [((camera,), value_of(camera)) for camera in cameras], "camera")
        frames = [((name,), camera.frames) for name, camera in cameras.items()]
        yield self._counter("frames", "Triggers whose frame arrived from the camera, whole.", frames, "camera")
        lost = [((name,), camera.lost) for name, camera in cameras.items()]
        yield self._counter("lost_frames", "Triggers whose frame did not.", lost, "camera")

    def _counts(self, status: Status) -> Iterator[Metric]:
        for counter, count in counters(status.counts):
            yield self._counter(counter.name, counter.meaning, count)
        lost = _of_all((*LossReason, *map(missing, status.cameras)), status.lost)
        yield self._counter("lost_triggers", "Triggers that made no whole set of frames.", lost, "reason")

    def _durations(self, status: Status) -> Iterator[Metric]:
        for duration in DURATIONS:
            name = f"{duration.field.removesuffix('_ms')}_seconds"
            yield self._summary(name, duration.meaning, getattr(status, duration.field))

    def _publishing(self, publishing: PublishStatus) -> Iterator[Metric]:
        yield self._counter("published_pairs", "Pairs sent to other processes.", publishing.sent)
        dropped = _of_all(DropReason, publishing.dropped)
        yield self._counter("unpublished_pairs", "Pairs that were not sent.", dropped, "reason")
        consumers = publishing.consumers.items()
        there = len(consumers) + publishing.unlisted_consumers
        yield self._gauge("consumers", "Consumers that report, including those not listed.", there)
        pairs = [((name,), tally.pairs) for name, tally in consumers]
        yield self._counter("consumer_pairs", "Pairs that a consumer received, by its own count.", pairs, "consumer")
        missed = [((name,), tally.missed) for name, tally in consumers]
        yield self._counter(
            "consumer_missed_frames", "Frames missed between them, by gaps in the frame id.", missed, "consumer"
        )
        lost = [((name, "in_transit"), tally.lost) for name, tally in consumers]
        lost += [((name, "too_slow"), tally.too_slow) for name, tally in consumers]
        yield self._counter("consumer_lost_pairs", "Pairs sent that it did not receive.", lost, "consumer", "reason")

    def _recorder(self, recorder: RecorderStatus) -> Iterator[Metric]:
        yield self._gauge("recorder_up", "Whether the recorder works.", float(recorder.failure is None))
        yield self._counter("recorder_steps", "Control steps it was given.", recorder.steps)
        yield self._counter("recorder_dropped_steps", "Steps dropped for lack of room.", recorder.dropped)

    def _requests(self, groups: Mapping[str, GroupStatus]) -> Iterator[Metric]:
        requests = {name: group.requests for name, group in groups.items()}
        locked = [((name,), float(each.locked is not None)) for name, each in requests.items()]
        yield self._gauge("exposure_locked", "Whether the exposure is locked.", locked, "group")
        ev_stops = [((name,), each.ev_stops) for name, each in requests.items()]
        yield self._gauge("ev_stops", "EV compensation.", ev_stops, "group")
        taken = [((name,), each.taken) for name, each in requests.items()]
        yield self._counter("control_requests", "Requests to control that were taken.", taken, "group")
        refused = [((name,), each.refused) for name, each in requests.items()]
        yield self._counter("refused_control_requests", "Requests that were refused.", refused, "group")

    def _tracking(self, tracking: TrackingTally) -> Iterator[Metric]:
        steered = float(tracking.age_s is not None)
        yield self._gauge("steered", "Whether consumers steered the newest decision.", steered)
        yield self._counter("tracking_reports", "Consumers' reports that were taken.", tracking.reports)
        refused = _of_all(TrackingRefusal, tracking.refused)
        yield self._counter("refused_tracking_reports", "Consumers' reports that were ignored.", refused, "reason")

    def _gauge(self, name: str, help_text: str, values: _Values, *labels: str) -> Metric:
        return self._filled(GaugeMetricFamily(f"autoexpose_{name}", help_text, labels=["rig", *labels]), values)

    def _counter(self, name: str, help_text: str, counts: _Values, *labels: str) -> Metric:
        return self._filled(CounterMetricFamily(f"autoexpose_{name}", help_text, labels=["rig", *labels]), counts)

    def _filled(self, metric: GaugeMetricFamily | CounterMetricFamily, values: _Values) -> Metric:
        for label_values, value in values if isinstance(values, Sequence) else [((), values)]:
            if value is not None:
                metric.add_metric([self._rig, *label_values], value)
        return metric

    def _summary(self, name: str, help_text: str, durations: DurationStatus) -> Metric:
        metric = SummaryMetricFamily(f"autoexpose_{name}", help_text, labels=["rig"])
        metric.add_metric([self._rig], durations.count, durations.sum_ms / _MS_PER_S)
        for quantile, value_ms in (("0.5", durations.p50_ms), ("0.99", durations.p99_ms)):
            if value_ms is not None:
                metric.add_sample(f"autoexpose_{name}", {"rig": self._rig, "quantile": quantile}, value_ms / _MS_PER_S)
        return metric


def _of_all(reasons: Iterable[str], counts: Mapping[str, int]) -> list[tuple[tuple[str, ...], int]]:
    """A count for every possible reason: an alert must not wait for the first."""
    return [((str(reason),), counts.get(str(reason), 0)) for reason in reasons]


def _ptp_offset_s(camera: CameraStatus) -> float | None:
    return None if camera.ptp is None or camera.ptp.offset_ns is None else camera.ptp.offset_ns * 1e-9


def _time_s(setting: ExposureSetting | None) -> float | None:
    return None if setting is None else setting.exposure_time_us / _US_PER_S


def _gain_db(setting: ExposureSetting | None) -> float | None:
    return None if setting is None else setting.gain_db
