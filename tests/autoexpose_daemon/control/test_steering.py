"""What consumers' reports come to: favours, weights, and what control makes of them in closed loop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.inputs import (
    CELLS,
    COLUMNS,
    MOST_FEATURES,
    ROWS,
    TrackedCells,
    count_by_cell,
)
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.contrast import contrast
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.picture.steering import (
    FORGOTTEN_S,
    FRESH_S,
    MOST_CONSUMERS,
    STEERING_SHARE,
    WEIGHT_STOPS,
    CellExposure,
    Steering,
    TrackingMemory,
    favours,
)
from autoexpose_daemon.control.policies.belief.scene_belief import BIN
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from autoexpose_daemon.control.step import NO_OVERRIDE, Override, StepInputs
from evaluation.stage.oracle import Information
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName

from .scene import LIMITS, LINEAR, START, alike, drive, expose, radiance

SHAPE = (ROWS, COLUMNS)
WELL = CellExposure(np.ones(SHAPE, np.float32), np.ones(SHAPE, np.float32))
NOWHERE = np.zeros(SHAPE, np.uint16)
LEFT, RIGHT = np.s_[:, : COLUMNS // 2], np.s_[:, COLUMNS // 2 :]
counts = arrays(np.uint16, SHAPE, elements=st.integers(0, 200))
any_favours = st.lists(st.floats(-1.0, 1.0), min_size=CELLS, max_size=CELLS).map(tuple)


def in_cells(where: Any, count: int = 20) -> NDArray[np.uint16]:
    cells = NOWHERE.copy()
    cells[where] = count
    return cells


def report(
    inliers: NDArray[np.uint16],
    features: NDArray[np.uint16] | None = None,
    consumer: str = "slam",
    camera: CameraName = "left",
) -> TrackedCells:
    return TrackedCells(consumer, 0, camera, inliers if features is None else features, inliers)


def remembered(*reports: TrackedCells, exposure: CellExposure = WELL, age_s: float = 0.0) -> NDArray[np.float64]:
    """Favours of the left camera's cells some time after reports on one frame."""
    memory = TrackingMemory()
    for one in reports:
        memory.take(one, exposure, 7.0)
    steering = memory.steering(7.0 + age_s)
    return np.zeros(SHAPE) if steering is None else np.reshape(steering.favours["left"], SHAPE)


@given(counts, counts)
def test_favours_are_bounded_and_nothing_is_said_where_there_is_nothing(
    inliers: NDArray[np.uint16], outliers: NDArray[np.uint16]
) -> None:
    found = favours(inliers, outliers)
    assert (np.abs(found) < 1.0).all()
    assert (found[inliers + outliers == 0] == 0.0).all()
    assert (found[outliers == 0] >= 0.0).all()
    if inliers.any():
        assert found.flat[inliers.argmax()] >= 0.0


@given(counts, counts, st.integers(0, CELLS - 1))
def test_more_inliers_never_count_less_nor_more_outliers_more(
    inliers: NDArray[np.uint16], outliers: NDArray[np.uint16], cell: int
) -> None:
    best = int(inliers.argmax())
    before = favours(inliers, outliers).flat[cell]
    if cell == best or inliers.flat[cell] < inliers.flat[best]:  # the cell to compare with stays the same
        more = inliers.copy()
        more.flat[cell] += 1
        assert favours(more, outliers).flat[cell] >= before - 1e-12
    if cell != best:
        worse = outliers.copy()
        worse.flat[cell] += 1
        assert favours(inliers, worse).flat[cell] <= before + 1e-12


def test_a_consumer_that_tracks_little_everywhere_is_as_good_as_one_that_tracks_much() -> None:
    few = favours(np.full(SHAPE, 2, np.uint16), np.full(SHAPE, 18, np.uint16))
    assert few == pytest.approx(0.0)


@given(any_favours, st.integers(1, 12), st.integers(1, 12))
def test_weights_stay_within_bounds_and_1_means_nothing_known(
    cells: tuple[float, ...], rows: int, columns: int
) -> None:
    weights = Steering({"left": cells}, ("slam",), 0.0).weights("left", rows, columns)
    assert weights.shape == (rows, columns)
    assert (weights >= 2**-WEIGHT_STOPS - 1e-9).all() and (weights <= 2**WEIGHT_STOPS + 1e-9).all()
    assert (Steering({"left": (0.0,) * CELLS}, ("slam",), 0.0).weights("right", rows, columns) == 1.0).all()


@given(any_favours, st.integers(0, CELLS - 1))
def test_a_favour_raises_the_weight_of_its_cell_and_of_no_other(cells: tuple[float, ...], cell: int) -> None:
    more = (*cells[:cell], 1.0, *cells[cell + 1 :])
    before, after = (Steering({"left": each}, ("slam",), 0.0).weights("left", ROWS, COLUMNS) for each in (cells, more))
    assert after.flat[cell] >= before.flat[cell]
    assert (np.delete(after, cell) == np.delete(before, cell)).all()


def test_a_cell_without_features_keeps_what_was_known_of_it() -> None:
    memory = TrackingMemory()
    memory.take(report(in_cells(LEFT)), WELL, 7.0)
    memory.take(report(in_cells(RIGHT)), WELL, 7.5)
    steering = memory.steering(7.5)
    assert steering is not None and min(steering.favours["left"]) > 0.5


def test_inliers_in_the_black_or_the_white_are_not_believed() -> None:
    readable = np.ones(SHAPE, np.float32)
    readable[LEFT] = 0.2
    found = remembered(report(in_cells(np.s_[:])), exposure=CellExposure(readable, readable))
    assert (found[LEFT] == 0.0).all() and (found[RIGHT] > 0.5).all()


def test_outliers_in_the_dark_are_not_held_against_it() -> None:
    dark = np.ones(SHAPE, np.float32)
    dark[LEFT] = 0.4
    inliers, features = in_cells(RIGHT), in_cells(np.s_[:])
    assert (remembered(report(inliers, features))[LEFT] < -0.5).all()
    found = remembered(report(inliers, features), exposure=CellExposure(WELL.readable, dark))
    assert (found[LEFT] == 0.0).all() and (found[RIGHT] > 0.5).all()


def test_who_is_lost_says_nothing() -> None:
    assert (remembered(report(in_cells(LEFT)), report(NOWHERE, in_cells(np.s_[:])))[LEFT] > 0.5).all()
    assert not remembered(report(NOWHERE, in_cells(np.s_[:]))).any()


def test_of_several_consumers_the_mean_counts() -> None:
    one, other = report(in_cells(LEFT)), report(in_cells(RIGHT), in_cells(np.s_[:]), "nav")
    alone = remembered(one), remembered(other)
    assert remembered(one, other)[LEFT] == pytest.approx((alone[0] + alone[1])[LEFT] / 2, abs=0.01)


def test_what_is_known_fades_and_is_forgotten() -> None:
    ages_s = np.linspace(0.0, FORGOTTEN_S, 31)
    favour = [float(remembered(report(in_cells(LEFT)), age_s=age_s)[0, 0]) for age_s in ages_s.tolist()]
    fresh = ages_s <= FRESH_S
    assert len({*np.array(favour)[fresh].tolist()}) == 1 and favour[0] > 0.5
    assert (np.diff(np.array(favour)[~fresh]) < 0).all() and favour[-1] == 0.0


def test_a_late_report_does_not_replace_a_later_one() -> None:
    memory = TrackingMemory()
    memory.take(report(in_cells(LEFT)), WELL, 7.5)
    memory.take(report(in_cells(RIGHT), in_cells(np.s_[:])), WELL, 7.0)
    steering = memory.steering(7.5)
    assert steering is not None and steering.age_s == 0.0
    assert (np.reshape(steering.favours["left"], SHAPE)[LEFT] > 0.5).all()


def test_only_consumers_that_say_something_steer() -> None:
    memory = TrackingMemory()
    memory.take(report(in_cells(LEFT)), WELL, 7.0)
    memory.take(report(np.zeros(SHAPE, np.uint16), in_cells(LEFT), "lost"), WELL, 8.5)
    steering = memory.steering(8.5)
    assert steering is not None and (steering.by, steering.age_s) == (("slam",), 1.5)


def test_so_many_consumers_steer_and_no_more_until_one_is_silent() -> None:
    memory = TrackingMemory()
    for number in range(MOST_CONSUMERS):
        assert memory.has_room(f"c{number}", 7.0)
        memory.take(report(in_cells(LEFT), consumer=f"c{number}"), WELL, 7.0)
    assert memory.has_room("c0", 7.0) and not memory.has_room("one more", 7.0)
    assert memory.has_room("one more", 7.0 + FORGOTTEN_S)
    assert memory.steering(7.0 + FORGOTTEN_S) is None


@pytest.mark.parametrize(
    ("features", "inliers", "why"),
    [
        (in_cells(LEFT, 3), in_cells(LEFT, 4), "more inliers than features"),
        (in_cells(LEFT, MOST_FEATURES + 1), NOWHERE, "10001 features in a cell"),
        (NOWHERE.ravel(), NOWHERE.ravel(), r"counts of shape \(48,\)"),
        (NOWHERE, np.full(SHAPE, -1), "below 0"),
        (np.full(SHAPE, np.nan), NOWHERE, "more inliers than features"),
        (np.full(SHAPE, 2.5), NOWHERE, "counts with fractions: give whole numbers"),
    ],
)
def test_impossible_counts_are_no_report(features: NDArray[np.uint16], inliers: NDArray[np.uint16], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        report(inliers, features)


def test_counts_may_be_lists_but_stamps_are_those_of_frames() -> None:
    TrackedCells("slam", 10, "left", NOWHERE.tolist(), NOWHERE.tolist())
    stamp: Any = 1.5
    with pytest.raises(ValueError, match=r"stamp of 1\.5: give the pair's"):
        TrackedCells("slam", stamp, "left", NOWHERE, NOWHERE)


def test_points_are_counted_in_the_cell_they_lie_in() -> None:
    counted = count_by_cell(np.array([[0.0, 0.0], [719.9, 539.9], [719.0, 0.5], [800.0, 5.0]]), 720, 540)
    assert counted.dtype == np.uint16 and counted.sum() == 3
    assert (counted[0, 0], counted[-1, -1], counted[0, -1]) == (1, 1, 1)
    assert count_by_cell(np.empty((0, 2)), 720, 540).sum() == 0


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_only_maps_of_information_and_the_belief_are_steered(policy_id: str) -> None:
    loops = [ControlLoop(policy_id, LINEAR, LIMITS, START) for _ in range(2)]
    steering = steer_to(RIGHT)
    same = followed(loops[0], None, 12) == followed(loops[1], steering, 12)
    assert [loop.steered for loop in loops] == [False, not same]
    assert same == (policy_id != DEFAULT_POLICY)


@pytest.mark.parametrize("override", [Override(held=START), Override(shot=START), Override(held=START, unseen=True)])
def test_a_setting_that_was_asked_for_is_not_steered(override: Override) -> None:
    loop = ControlLoop(DEFAULT_POLICY, LINEAR, LIMITS, START)
    for each, steered in ((override, False), (NO_OVERRIDE, True)):
        loop.step(replace(in_sun_and_shade(0, START, steer_to(RIGHT)), override=each))
        assert loop.steered == steered


SUN_AND_SHADE = radiance(3, 0.7)
SUN_AND_SHADE[:, :90] *= 2.0**1.5
SUN_AND_SHADE[:, 90:] /= 2.0**1.5
HALF_SCALE = 12.0


def steer_to(where: Any) -> Steering:
    """As a consumer that detects features everywhere and tracks those of a side."""
    memory = TrackingMemory()
    memory.take(report(in_cells(where), in_cells(np.s_[:])), WELL, 7.0)
    steering = memory.steering(7.0)
    assert steering is not None
    return steering


def in_sun_and_shade(index: int, setting: ExposureSetting, steering: Steering | None) -> StepInputs:
    return StepInputs(alike(expose(SUN_AND_SHADE, setting, HALF_SCALE), index), steering=steering)


def followed(loop: ControlLoop, steering: Steering | None, frames: int) -> list[Decision]:
    """Decisions on a picture with one side in the sun."""
    return drive(loop, frames, lambda index, setting: in_sun_and_shade(index, setting, steering))


def worth(setting: ExposureSetting, where: str = "both") -> float:
    """Information of the picture taken with a setting, or of one side of it."""
    image = ImagePreparation().prepare(expose(SUN_AND_SHADE, setting, HALF_SCALE).pixels.astype(np.uint8))
    weights = np.zeros(image.shape, np.uint8)
    weights[:, : 84 if where == "sun" else None] = 255
    if where == "shade":
        weights[:, :96] = 0
    information = Information(LINEAR)
    return information.measure(contrast(image, information.bins, weights), 1.0, 1.0)


def test_the_side_that_is_tracked_is_exposed_better_and_the_whole_not_much_worse() -> None:
    found = {
        name: followed(ControlLoop(DEFAULT_POLICY, LINEAR, LIMITS, START), steering, 60)[-1].setting
        for name, steering in {"nobody": None, "sun": steer_to(LEFT), "shade": steer_to(RIGHT)}.items()
    }
    assert found["sun"].level <= found["nobody"].level < found["shade"].level
    assert worth(found["sun"], "sun") > worth(found["shade"], "sun")
    assert worth(found["shade"], "shade") > 1.05 * worth(found["nobody"], "shade")
    best = max(worth(found[name]) for name in found)
    assert min(worth(setting) for setting in found.values()) > (1.0 - STEERING_SHARE - 0.1) * best


def test_when_consumers_turn_to_the_other_side_control_does_too() -> None:
    loop = ControlLoop(DEFAULT_POLICY, LINEAR, LIMITS, START)
    levels = [followed(loop, steer_to(where), 40)[-1].setting.level for where in (RIGHT, LEFT, RIGHT)]
    assert levels[0] - levels[1] > 0.4 and levels[2] - levels[1] > 0.4


def test_a_steered_exposure_does_not_swing() -> None:
    decisions = followed(ControlLoop(DEFAULT_POLICY, LINEAR, LIMITS, START), steer_to(RIGHT), 60)
    assert np.ptp([decision.setting.level for decision in decisions[30:]]) <= 0.1


def test_who_claims_to_track_in_the_dark_steers_nothing() -> None:
    """The exposure of the frame itself contradicts it."""
    frame = expose(SUN_AND_SHADE, ExposureSetting(20.0, 0.0), HALF_SCALE).pixels.astype(np.uint8)
    exposure = CellExposure.of(ImagePreparation().prepare(frame), LINEAR)
    assert not remembered(report(in_cells(RIGHT), in_cells(np.s_[:])), exposure=exposure)[RIGHT].any()


def test_steering_that_ends_leaves_nothing_behind() -> None:
    loop, other = (ControlLoop(DEFAULT_POLICY, LINEAR, LIMITS, START) for _ in range(2))
    followed(loop, steer_to(RIGHT), 40)
    rest, never = followed(loop, None, 60)[-1], followed(other, None, 60)[-1]
    assert rest.setting.level == pytest.approx(never.setting.level, abs=0.6)


@pytest.mark.parametrize(("steer", "steered"), [(None, False), (RIGHT, True)])
def test_the_reason_of_a_decision_says_that_it_was_steered(steer: Any, steered: bool) -> None:
    loop = ControlLoop(DEFAULT_POLICY, LINEAR, LIMITS, START)
    decision = followed(loop, steer and steer_to(steer), 3)[-1]
    assert decision.reason.endswith("; steered") == steered


def test_a_moving_camera_leaps_once_when_consumers_turn_and_then_stays() -> None:
    """Every 25 frames. Odometry loses the pair at the leap, and no other."""
    parameters, milder = ControlParameters(focal_length_px=800.0), np.where(np.arange(180) < 90, 2.0**-0.5, 2.0**0.5)

    def take(index: int, setting: ExposureSetting) -> StepInputs:
        pair = alike(expose(SUN_AND_SHADE * milder, setting, HALF_SCALE), index)
        return StepInputs(pair, 0.3, steering=steer_to(LEFT if index // 25 % 2 else RIGHT))

    decisions = drive(ControlLoop(DEFAULT_POLICY, LINEAR, LIMITS, START, parameters), 100, take)
    levels = np.reshape([decision.setting.level for decision in decisions], (4, 25))
    assert np.ptp(levels[:, 12:], axis=1).max() < 1.1 * BIN  # one level of the plan
    assert np.ptp(levels[:, -1]) > 0.2
