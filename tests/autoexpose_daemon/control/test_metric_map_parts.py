"""The parts of `metric-map`, one idea at a time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.policies.belief.forecast import LEAST_CHANGE, LEAST_FRAMES, RESIDUE, Forecast
from autoexpose_daemon.control.policies.belief.loop_delay import LoopDelay
from autoexpose_daemon.control.policies.metric_map.memory import FORGOTTEN, LEAST_GAP, MetricMemory, Sighting
from autoexpose_daemon.control.policies.metric_map.search import Probes, dark_jump, plateau_centre
from autoexpose_daemon.control.policies.metric_map.view import DELTAS, FEWER_DELTAS, FEWEST_DELTAS, MetricView, Viewer
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.registration import Registration
from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting

from .scene import expose, radiance

LINEAR = ResponseFunction.linear()


def frame(level: float, half_scale_level: float, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    grey = expose(radiance(4, 1.0, (270, 360)), ExposureSetting(float(2.0**level), 0.0), half_scale_level).grey8()
    noisy = grey + np.random.default_rng(seed).normal(0.0, noise, grey.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def view(peak: float = 0.0, saturated_share: float = 0.0, height: float = 1.0) -> MetricView:
    """A curve with its peak at a delta."""
    return MetricView(height * np.exp(-((DELTAS - peak) ** 2)), saturated_share, 0.0, 0.5)


def test_the_edge_between_white_and_black_says_nothing_of_the_light() -> None:
    """It is grey at any exposure, and where all else is clipped nothing outvotes it."""
    registration = Registration({"left": LINEAR})
    picture = np.zeros((270, 360), np.uint8)
    picture[:, 180:] = 255
    picture[:, 179:181] = 127
    registration.change(Look("left", picture, LINEAR), 10.0)
    change = registration.change(Look("left", picture, LINEAR), 13.0)
    assert change is None or not change.measured


@pytest.mark.parametrize(("change", "level_change"), [(0.0, 1.5), (0.7, 0.0), (-1.0, 1.0), (2.0, -1.0)])
def test_registration_separates_light_from_exposure(change: float, level_change: float) -> None:
    registration = Registration({"left": LINEAR})
    registration.change(Look("left", frame(11.0, 11.5), LINEAR), 11.0)
    light = registration.change(Look("left", frame(11.0 + level_change, 11.5 - change), LINEAR), 11.0 + level_change)
    assert light is not None
    assert light.measured
    assert light.stops == pytest.approx(change, abs=0.05)


def test_registration_is_not_misled_by_the_noise_of_the_unclipped_rest() -> None:
    """After a drop of 5.5 stops only noise peaks are unclipped in both frames; they alone would give about half."""
    registration = Registration({"left": LINEAR})
    registration.change(Look("left", frame(11.0, 10.0), LINEAR), 11.0)
    light = registration.change(Look("left", frame(11.0, 15.5, noise=4.0), LINEAR), 11.0)
    assert light is not None
    assert light.stops < -3.5


def test_registration_says_when_it_has_only_a_bound() -> None:
    registration = Registration({"left": LINEAR})
    assert registration.change(Look("left", frame(11.0, 12.0), LINEAR), 11.0) is None
    light = registration.change(Look("left", np.full((270, 360), 255, np.uint8), LINEAR), 11.0)
    assert light is not None
    assert not light.measured
    assert light.stops > 1


def test_registration_ignores_masked_pixels() -> None:
    registration, weights = Registration({"left": LINEAR}), np.full((270, 360), 255, np.uint8)
    weights[:, :250] = 0
    registration.change(Look("left", frame(11.0, 11.5), LINEAR, weights), 11.0)
    brighter = frame(11.0, 10.5)
    brighter[:, 250:] = frame(11.0, 11.5)[:, 250:]
    light = registration.change(Look("left", brighter, LINEAR, weights), 11.0)
    assert light is not None
    assert light.stops == pytest.approx(0.0, abs=0.02)


def test_registration_sees_nothing_where_only_pixels_count_that_it_skips() -> None:
    registration, weights = Registration({"left": LINEAR}), np.zeros((270, 360), np.uint8)
    weights[101:104, 101:104] = 255
    for _ in range(2):
        assert registration.change(Look("left", frame(11.0, 11.5), LINEAR, weights), 11.0) is None


def test_the_map_prefers_the_nearest_sighting_and_moves_with_the_light() -> None:
    memory = MetricMemory()
    memory.add(Sighting(10.0, (view(0.0),)))
    memory.add(Sighting(13.0, (view(-3.0, height=1.01),)))
    memory.add(Sighting(16.0, (view(-6.0, height=0.99),)))
    levels = np.arange(6.0, 18.0, 0.25)
    assert levels[memory.fuse(levels, moving=True)[0].argmax()] == 10.0
    memory.pass_frame(2.0, 0.0)  # brighter: the same pictures at lower levels
    assert levels[memory.fuse(levels, moving=True)[0].argmax()] == 8.0


def test_what_saturation_hides_is_taken_from_a_darker_frame() -> None:
    """Between a blind frame above and a seeing one below, the nearer of the two is the blind one."""
    levels = np.array([11.5])
    for share, expected in ((0.0, 0.1), (0.9, 1.0)):
        memory = MetricMemory()
        memory.add(Sighting(9.5, (MetricView(np.full(DELTAS.shape, 1.0), 0.0, 0.0, 0.5),)))
        memory.sightings.append(Sighting(12.0, (MetricView(np.full(DELTAS.shape, 0.1), share, 0.0, 1.0),)))
        assert memory.fuse(levels, moving=True)[0, 0] == pytest.approx(expected, abs=0.3)


def test_a_still_camera_doubts_far_brighter_levels_and_a_moving_one_goes_there() -> None:
    promise = MetricView(np.interp(DELTAS, [2.0, 6.0], [0.8, 1.0]), 0.0, 0.0, 0.5)
    memory = MetricMemory([Sighting(8.0, (promise,))])
    levels = np.array([10.0, 14.0])
    assert np.diff(memory.fuse(levels, moving=True)[0]) > 0
    assert np.diff(memory.fuse(levels, moving=False)[0]) < 0


def test_a_contradiction_empties_the_map() -> None:
    memory = MetricMemory()
    memory.add(Sighting(10.0, (view(0.0),)))
    memory.add(Sighting(11.0, (view(-1.0),)))
    assert len(memory.sightings) == 2
    memory.add(Sighting(10.5, (view(2.0, height=0.3),)))
    assert len(memory.sightings) == 1


def test_a_change_in_the_number_of_cameras_empties_the_map() -> None:
    memory = MetricMemory()
    memory.add(Sighting(10.0, (view(),)))
    memory.add(Sighting(12.0, (view(-2.0), view(-2.0))))
    assert len(memory.sightings) == 1


def test_old_sightings_are_forgotten() -> None:
    memory = MetricMemory()
    memory.add(Sighting(10.0, (view(),)))
    memory.pass_frame(0.0, FORGOTTEN)
    assert not memory.sightings


def test_a_gap_is_a_frontier_for_a_still_camera_only() -> None:
    memory = MetricMemory([Sighting(8.0, (view(),)), Sighting(15.0, (view(),))])
    frontier, known_again = memory.frontier(3.0)
    assert (frontier.level, known_again) == (15.0, 11.0)
    frontier, known_again = memory.frontier(np.inf)
    assert (frontier.level, known_again) == (8.0, -np.inf)


def test_a_narrow_gap_is_not_a_frontier() -> None:
    memory = MetricMemory([Sighting(8.0, (view(),)), Sighting(8.0 + 3.0 + LEAST_GAP, (view(),))])
    assert memory.frontier(3.0) == (memory.sightings[0], -np.inf)


def test_a_ramp_goes_on() -> None:
    forecast = Forecast()
    for _ in range(30):
        forecast.add(0.13)
    assert forecast.period() is None
    assert forecast.ahead(2, steady=True) == pytest.approx(0.26)
    assert forecast.ahead(2, steady=False) == 0
    forecast.add(-0.13)
    assert forecast.ahead(2, steady=True) == 0


@pytest.mark.parametrize("cycle", [[0.0, 2.0, -2.0], [0.0] * 14 + [3.0] + [0.0] * 14 + [-3.0]])
@pytest.mark.parametrize("delay", [1, 2, 3, 5])
def test_a_periodic_change_is_expected_again(cycle: list[float], delay: int) -> None:
    forecast, rng = Forecast(), np.random.default_rng(1)
    coming = cycle * 40
    for change in coming[:90]:
        forecast.add(change + rng.normal(0.0, 0.02))
    assert forecast.period() == len(cycle)
    assert forecast.ahead(delay, steady=False) == pytest.approx(sum(coming[90 : 90 + delay]), abs=0.2)


def test_light_swings_by_what_it_rises_and_falls_again() -> None:
    forecast = Forecast()
    for _ in range(20):
        forecast.add(0.5)
    assert forecast.swing() == pytest.approx(0.0)
    for change in [2.0, -1.0, -0.5] * 4:
        forecast.add(change)
    assert forecast.swing() == pytest.approx(4 * 3.5 - 4 * 0.5)


def test_random_changes_have_no_period() -> None:
    forecast, rng = Forecast(), np.random.default_rng(2)
    for change in rng.normal(0.0, 0.5, 96):
        forecast.add(change)
    assert forecast.period() is None


def slow_period(changes: list[float]) -> int | None:
    """The shortest lag, of at least two periods, at which the newest changes are large and recur."""
    for lag in range(2, len(changes) // 2 + 1):
        seen = np.array(changes)[-max(2 * lag, LEAST_FRAMES + lag) :]
        large = len(seen) >= LEAST_FRAMES + 2 and np.var(seen) >= LEAST_CHANGE**2
        if large and np.mean((seen[lag:] - seen[:-lag]) ** 2) < 2 * RESIDUE * np.var(seen):
            return lag
    return None


@given(
    length=st.integers(0, 96),
    cycle=st.lists(st.sampled_from([0.0, 0.0, 0.1, 0.2, 1.0, -1.0, -0.2]), min_size=1, max_size=50),
    noise=st.sampled_from([0.0, 0.02, 0.05, 0.1, 0.3]),
    still_frames=st.integers(0, 96),
    seed=st.integers(0, 99),
)
def test_looking_at_all_lags_at_once_misses_no_period(
    length: int, cycle: list[float], noise: float, still_frames: int, seed: int
) -> None:
    changes = (np.resize(cycle, length) + np.random.default_rng(seed).normal(0.0, noise, length)).tolist()
    forecast = Forecast()
    for change in [0.0] * still_frames + changes:
        forecast.add(change)
    assert forecast.period() == slow_period(list(forecast.changes))


@pytest.mark.parametrize("delay", [1, 2, 3, 6])
def test_the_delay_is_found_in_the_settings_of_frames(delay: int) -> None:
    latency, asked, targets = LoopDelay(), [10.0] * delay, list[float]()
    for index in range(30):
        latency.see(asked[index], targets)
        target = 10.0 if index < 12 else 13.0
        targets.append(target)
        asked.append(target)
    assert latency.frames == delay


def test_a_frame_that_is_lost_on_the_way_does_not_change_the_delay() -> None:
    latency, asked, targets = LoopDelay(), [10.0] * 4, list[float]()
    for index in range(48):
        if index != 42:  # one that follows a change
            latency.see(asked[index], targets)
            targets.append(10.0 + 3.0 * (index // 10 % 2))
        asked.append(targets[-1])
    assert latency.frames == 4


def test_the_centre_of_the_plateau() -> None:
    levels = np.arange(10.0)
    assert plateau_centre(levels, np.array([0.2, 0.5, 0.9, 0.995, 1.0, 0.991, 0.4, 0.3, 0.999, 0.1])) == 4.0


def test_probes_go_farther_the_more_is_clipped() -> None:
    stops, probes = np.arange(-3.0, 11.0, 0.25), Probes(shortest_stops=1.5, power=1.0, worth=1.5)
    little = probes.bonus(stops, 0.1, 0.2, moving=False)
    much = probes.bonus(stops, 1.0, 0.2, moving=False)
    assert stops[little.argmax()] == 2.0
    assert stops[much.argmax()] == 6.5
    assert much.max() > 5 * little.max()
    assert (much[stops <= 0] == 0).all()
    assert (probes.bonus(stops, 0.0, 0.2, moving=True) == 0).all()


def test_dark_frames_jump_to_full_scale_and_no_farther_than_7_stops() -> None:
    assert dark_jump(4 / 255, LINEAR) == pytest.approx(6.0, abs=0.01)
    assert dark_jump(0.5 / 255, LINEAR) == 7.0
    assert dark_jump(0.2, LINEAR) == 0.0
    raised = ResponseFunction.linear(black_level=20)
    assert dark_jump(4 / 235, raised) == pytest.approx(5.9, abs=0.1)


def test_the_second_camera_is_predicted_more_coarsely_but_alike() -> None:
    image = frame(11.0, 11.5)
    fine = Viewer(LINEAR, GradientMetric(), list(DELTAS)).view(Look("left", image, LINEAR))
    coarse = Viewer(LINEAR, GradientMetric(), list(FEWER_DELTAS)).view(Look("left", image, LINEAR))
    assert coarse.curve == pytest.approx(fine.curve, abs=0.08 * fine.curve.max())
    assert coarse.signal == fine.signal


@pytest.mark.parametrize("deltas", [DELTAS, FEWER_DELTAS])
def test_a_view_gives_the_metric_of_the_image_itself(deltas: np.ndarray) -> None:
    metric, image = GradientMetric(), frame(11.0, 11.5)
    curved = ResponseFunction(np.linspace(0.0, 4.0, 256) ** 1.5, 0, 255)
    assert Viewer(curved, metric, list(deltas)).view(Look("left", image, curved)).curve[
        DELTAS == 0.0
    ] == metric.measure(image)


@pytest.mark.parametrize(("share", "remembered"), [(0.85, 2), (0.5, 1), (2.0, 1)])
def test_a_scene_half_as_rich_as_expected_is_a_different_one(share: float, remembered: int) -> None:
    """Predictions elsewhere are then worthless; a little less than expected is just an error of prediction."""
    memory = MetricMemory()
    memory.add(Sighting(10.0, (view(2.0),)))
    memory.add(Sighting(11.0, (view(1.0, height=share),)))
    assert len(memory.sightings) == remembered


def test_a_still_camera_prefers_a_sure_peak_to_a_prediction_a_stop_beyond_trust() -> None:
    """Beyond 3 stops up prediction takes noise for gradient: each further stop is worth 0.6 of what is predicted."""
    sure, beyond = (
        np.array([10.0, 12.0]),
        Sighting(8.0, (MetricView(np.interp(DELTAS, [2.0, 4.0], [0.65, 1.0]), 0.0, 0.0, 0.5),)),
    )
    now, later = MetricMemory([beyond]).fuse(sure, moving=False)[0]
    assert now == pytest.approx(0.65)
    assert 0.55 < later < 0.65


def test_what_was_seen_on_the_way_into_a_tunnel_is_kept() -> None:
    """8 stops in a second are 0.13 a frame."""
    memory = MetricMemory()
    for _ in range(10):
        memory.pass_frame(-0.13, 0.0)
        memory.add(Sighting(12.0, (view(0.0, height=1.0),)))
    assert len(memory.sightings) > 8


@pytest.mark.parametrize("deltas", [DELTAS, FEWER_DELTAS, FEWEST_DELTAS])
def test_predicted_changes_rise_from_6_stops_down_to_6_up(deltas: np.ndarray) -> None:
    assert (np.diff(deltas) > 0).all()
    assert (deltas[0], deltas[-1]) == (-6.0, 6.0)
    assert 0.0 in deltas


@pytest.mark.parametrize("deltas", [FEWER_DELTAS, FEWEST_DELTAS])
def test_few_predictions_favour_neither_direction(deltas: np.ndarray) -> None:
    assert deltas.tolist() == (-deltas[::-1]).tolist()
