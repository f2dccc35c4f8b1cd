"""The oracle's short cuts compared with trying everything."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from autoexpose_daemon.control.balance import Balance, BlurNoiseBalance, ExposurePriority, FixedGain, FixedRatio
from evaluation.arena.race import course_of, race
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.stage.camera import LIMITS, Entrant
from evaluation.stage.oracle import LEVELS, Oracle, rounded_motion
from evaluation.stage.rendering import Stage
from fake_camera.world.simulation import Side
from imaging.exposure import ExposureSetting


@cache
def stage_at(scenario: str, scene: str, seed: int, frame: int) -> Stage:
    stage, _ = course_of(scenario, scene, seed)
    stage.go_to(frame)
    return stage


@pytest.mark.parametrize(
    ("scenario", "scene", "seed", "frame"),
    [
        ("step_down", "street", 1003, 80),  # hills so narrow that a coarser grid misses the best one
        ("pan", "leaves", 6, 75),
        ("lowlight_fast", "shelves", 4, 50),
        ("flicker", "street", 7, 61),
        ("tunnel", "room", 5, 100),
    ],
)
@pytest.mark.parametrize("balance", [ExposurePriority(), BlurNoiseBalance(0.02, 8.0), FixedRatio()])
def test_search_finds_what_trying_everything_finds(
    scenario: str, scene: str, seed: int, frame: int, balance: Balance
) -> None:
    stage = stage_at(scenario, scene, seed, frame)
    quick = Oracle(stage).best(balance, 7.3)
    exhaustive = Oracle(stage, exhaustive=True).best(balance, 7.3)
    assert quick is not None and exhaustive is not None
    assert quick.metrics[0] == pytest.approx(exhaustive.metrics[0], rel=0.005)
    assert quick.level == pytest.approx(exhaustive.level, abs=0.3)


def test_no_split_is_better_than_the_best_of_all() -> None:
    oracle = Oracle(stage_at("pan", "room", 3, 100))
    best = oracle.best_of_all()
    assert best is not None
    balances = (ExposurePriority(), BlurNoiseBalance(0.02, 8.0), FixedRatio(), FixedGain(12.0))
    splits = [oracle.best(balance, 7.3) for balance in balances]
    shares = [split.metrics[0] / best.metrics[0] for split in splits if split is not None]
    assert len(shares) == 4 and max(shares) <= 1.005
    assert min(shares) < 0.9  # a poor split costs


def test_two_cameras_share_one_exposure() -> None:
    stage, _ = course_of("lamp_right", "leaves", 6)
    stage.go_to(50)
    sides: tuple[Side, Side] = ("left", "right")
    balance = ExposurePriority()
    quick, exhaustive = (Oracle(stage, sides, exhaustive=flag).best(balance, 0.0) for flag in (False, True))
    assert quick is not None and exhaustive is not None
    assert quick.joint == pytest.approx(exhaustive.joint, rel=0.005)
    assert quick.joint < 0.99
    judge = Oracle(stage, sides)
    ratios = []
    for level in LEVELS:
        setting = LIMITS.realise(float(level), balance.exposure_time_us(float(level), 0.0, LIMITS))
        ratios.append(np.mean(np.divide(judge.judge(setting), exhaustive.metrics)) / exhaustive.joint)
    assert max(ratios) == pytest.approx(1.0)


@pytest.mark.long
def test_interpolating_the_oracle_changes_ratios_little() -> None:
    """At the frames in between, where it was not asked: the mean over all frames errs by half as much."""
    entrants = [Entrant.of("begin2022"), Entrant.of("neves2009")]
    stage, first_scored = course_of("pan", "shelves", 4)
    every = SCENARIOS["pan"].oracle_every
    runs = race(stage, entrants, Oracle(stage), frames=48, first_scored=first_scored, every=every)
    exact, asked = Oracle(stage, exhaustive=True), runs[0].by_metric.best
    between = [frame for frame in range(first_scored, 48) if frame not in asked]
    ratios: dict[str, list[float]] = {entrant.name: [] for entrant in entrants}
    for frame in between:
        stage.go_to(frame)
        for series in runs:
            best = exact.best(series.delayed.loop.balance, series.delayed.decisions[frame].motion_px)
            assert best is not None
            ratios[series.entrant.name].append(series.metrics[frame, 0] / best.metrics[0])
    for series in runs:
        assert series.ratios[between].mean() == pytest.approx(np.mean(ratios[series.entrant.name]), abs=0.008)


def test_nothing_to_see_is_no_best() -> None:
    class Dark:
        frame = 0

        def expose(self, _side: Side, _setting: ExposureSetting) -> np.ndarray:
            return np.zeros((540, 720), np.uint8)

    assert Oracle(Dark()).best(ExposurePriority(), 0.0) is None  # type: ignore[arg-type]


def test_motion_is_rounded_to_half_octaves() -> None:
    assert rounded_motion(0.3) == 0.0
    assert rounded_motion(8.0) == 8.0
    assert rounded_motion(9.4) == 8.0
    assert rounded_motion(9.6) == pytest.approx(8 * 2**0.5)
