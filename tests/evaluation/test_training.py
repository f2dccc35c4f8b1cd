"""Training: gradients, the world it takes place in, and weights of the same bytes for the same seed."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from autoexpose_daemon.control.policies import learned
from autoexpose_daemon.control.policies.ids import LEARNED
from autoexpose_daemon.control.policies.learned.net import Net
from evaluation.arena.runs import HELD_OUT_SEEDS, TUNE_SCENES
from evaluation.committed import FURNISHED_ROOMS, HELD_OUT_SEED
from evaluation.training import berthold2013, tomasi2021, trainings, zhang2024
from evaluation.training import episode as pictures
from evaluation.training.berthold2013 import TrainingOfBerthold
from evaluation.training.episode import (
    COLUMNS,
    FAR_STOPS,
    PAINTERS,
    ROWS,
    SEEDS,
    Episode,
    TrainingPicture,
    babbled_levels,
    random_light,
    random_path,
)
from evaluation.training.tomasi2021 import TrainingOfTomasi, best_level
from evaluation.training.training import LARGEST_BYTES, Arrays, TrainedNet, Training, train, weights_bytes
from evaluation.training.training_app import train_command
from evaluation.training.zhang2024 import ActorCritic, TrainingOfZhang, Transitions, reward
from imaging.errors import AutoexposeError, ConfigurationError


def double_net(sizes: tuple[int, ...], seed: int) -> tuple[Arrays, TrainedNet]:
    """In float64, in which differences show slopes to many digits."""
    rng, arrays = np.random.default_rng(seed), {}
    net = TrainedNet.begin(arrays, "net", sizes, rng)
    for name in net.names:
        arrays[name] = arrays[name].astype(np.float64) + 0.1 * rng.standard_normal(arrays[name].shape)
    return arrays, net


def loss(net: TrainedNet, inputs: np.ndarray, wanted: np.ndarray) -> float:
    return 0.5 * float(np.sum((net.forward(inputs) - wanted) ** 2))


def test_gradients_are_those_of_finite_differences() -> None:
    arrays, net = double_net((5, 7, 4, 2), 3)
    rng = np.random.default_rng(4)
    inputs, wanted = rng.standard_normal((6, 5)), rng.standard_normal((6, 2))
    gradients, of_inputs = net.backward(net.forward(inputs) - wanted)
    step = 1e-6
    for values, gradient in [*((arrays[name], each) for name, each in zip(net.names, gradients, strict=True)),
                             (inputs, of_inputs)]:  # fmt: skip
        assert values.shape == gradient.shape
        for place in rng.integers(values.size, size=8):
            kept = values.flat[place]
            values.flat[place] = kept + step
            above = loss(net, inputs, wanted)
            values.flat[place] = kept - step
            below = loss(net, inputs, wanted)
            values.flat[place] = kept
            assert gradient.flat[place] == pytest.approx((above - below) / (2 * step), abs=1e-6)


def test_a_net_follows_another_by_a_share() -> None:
    rng, arrays = np.random.default_rng(0), {}
    net = TrainedNet.begin(arrays, "net", (3, 2, 1), rng)
    slow = net.copy_to("slow_net")
    arrays["net.offsets1"] += 1.0
    slow.follow(net, 0.25)
    assert arrays["slow_net.offsets1"] == pytest.approx([0.25])
    assert arrays["slow_net.matrix0"] == pytest.approx(arrays["net.matrix0"])


def test_the_actor_finds_the_action_that_earns_most() -> None:
    """Here the one that equals half of what is seen."""
    rng, state = np.random.default_rng(1), {}
    learner = ActorCritic.begin(state, 1, rng)
    for number in range(600):
        seen = rng.uniform(-1.0, 1.0, (64, 1)).astype(np.float32)
        done = rng.uniform(-1.0, 1.0, (64, 1)).astype(np.float32)
        later = rng.uniform(-1.0, 1.0, (64, 1)).astype(np.float32)
        learner.update(Transitions(seen, done, -np.abs(done - seen / 2), later), number, 3e-3, rng)
    seen = np.linspace(-0.9, 0.9, 7, dtype=np.float32)[:, None]
    assert learner.act(seen) == pytest.approx(seen / 2, abs=0.15)


def patches(seed: int) -> TrainingPicture:
    light = np.exp2(np.random.default_rng(seed).normal(-2.0, 1.0, (33, 50)))
    return TrainingPicture(np.kron(light, np.ones((8, 8))).astype(np.float32), 4)


def episode(seed: int, frames: int = 30) -> Episode:
    return Episode([patches(seed)], np.random.default_rng(seed), frames)


def test_pictures_are_of_tuning_scenes_and_tuning_seeds() -> None:
    assert {*PAINTERS, "room"} <= {*TUNE_SCENES}
    assert not {*PAINTERS} & ({*HELD_OUT_SEEDS} - {"room"})
    assert max(SEEDS) < 100 < HELD_OUT_SEED and not {*SEEDS} & {*FURNISHED_ROOMS}


def test_of_each_seed_there_are_paintings_and_a_room_all_around() -> None:
    found = pictures.tuning_pictures(1)
    assert len(found) == len(PAINTERS) + pictures.HEADINGS
    for each in found:
        rows, columns = each.light.shape
        assert rows >= ROWS * each.stride and columns >= COLUMNS * each.stride
        assert np.isfinite(each.light).all() and (each.light >= 0).all()


@pytest.mark.parametrize("seed", range(5))
def test_the_level_of_a_mean_gives_that_mean(seed: int) -> None:
    one = episode(seed)
    level = one.level_of_mean(3, 0.3)
    look = one.look(3, one.setting(level))
    black = look.response.black_level
    mean = (float(look.image.mean()) - black) / (255 - black)
    at_limit = level in (one.limits.darkest.level, one.limits.brightest.level)
    assert mean == pytest.approx(0.3, abs=0.03) or at_limit


@pytest.mark.parametrize("seed", range(3))
def test_matches_are_most_where_the_picture_is_neither_black_nor_white(seed: int) -> None:
    one = episode(seed)
    level = best_level(one, 5)
    assert level is not None and one.limits.darkest.level <= level <= one.limits.brightest.level
    assert 0.01 < float(one.look(5, one.setting(level)).image.mean()) / 255 < 0.98


def test_light_and_path_stay_where_they_may(frames: int = 80) -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        lux, path = random_light(rng, frames), random_path(rng, frames, 300)
        assert lux.shape == path.shape == (frames,)
        assert (lux > 0).all() and path.min() >= 0 and path.max() <= 300
        assert np.abs(np.diff(path)).max() <= 22


def test_babbling_looks_near_and_far() -> None:
    apart = np.array(babbled_levels([10.0] * 500, np.random.default_rng(1))) - 10.0
    assert np.abs(apart).max() > FAR_STOPS / 2
    assert np.mean(np.abs(apart) < 1.0) > 0.3


TINY: dict[str, Callable[[], Training]] = {
    "berthold2013": lambda: TrainingOfBerthold(rounds=3, episodes=2),
    "tomasi2021": lambda: TrainingOfTomasi(rounds=3, episodes=1, updates=3, polish=3),
    "zhang2024": lambda: TrainingOfZhang(rounds=3, episodes=2, frames=12, updates=4),
}

app = typer.Typer()
app.command()(train_command)


@pytest.fixture(autouse=True)
def one_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Patches instead of rooms, whose textures take seconds; few units, few labels."""
    patches = np.exp2(np.random.default_rng(0).normal(-2.0, 1.5, (33, 45)))
    picture = TrainingPicture(np.kron(patches, np.ones((8, 8))).astype(np.float32), 4)
    for module in (berthold2013, tomasi2021, zhang2024):
        monkeypatch.setattr(module, "tuning_pictures", lambda _count: [picture])
    monkeypatch.setattr(berthold2013, "UNITS", 20)
    monkeypatch.setattr(tomasi2021, "LABEL_EVERY", 30)
    monkeypatch.setattr(tomasi2021, "VARIANTS", 1)


def nothing(_done: int) -> None: ...


def stop_after(rounds: int) -> Callable[[int], None]:
    def advance(done: int) -> None:
        if done == rounds:
            raise KeyboardInterrupt

    return advance


@pytest.mark.parametrize("policy_id", LEARNED)
def test_an_interrupted_training_ends_with_the_bytes_of_one_that_was_not(policy_id: str, tmp_path: Path) -> None:
    whole = train(TINY[policy_id](), 5, tmp_path / "whole.npz", nothing)
    halves, begun = tmp_path / "halves.npz", []
    for rounds in (1, 2):
        with pytest.raises(KeyboardInterrupt):
            train(TINY[policy_id](), 5, halves, stop_after(rounds))
        assert not halves.exists()
    assert train(TINY[policy_id](), 5, halves, begun.append) == whole
    assert begun == [2, 3]
    assert halves.read_bytes() == whole and not (tmp_path / "halves.npz.part").exists()
    other = train(TINY[policy_id](), 6, halves, nothing)
    assert other != whole and len(other) <= LARGEST_BYTES
    assert Net.of(dict(np.load(halves)), "relu").learnt.furthest > 0


def test_another_seed_does_not_continue_an_interrupted_training(tmp_path: Path) -> None:
    file, begun = tmp_path / "weights.npz", []
    with pytest.raises(KeyboardInterrupt):
        train(TINY["zhang2024"](), 1, file, stop_after(2))
    train(TINY["zhang2024"](), 2, file, begun.append)
    assert begun == [0, 1, 2, 3]


def test_what_was_done_before_may_be_damaged(tmp_path: Path) -> None:
    (tmp_path / "weights.npz.part").write_bytes(b"PK\x03\x04 and no more")
    begun: list[int] = []
    train(TINY["berthold2013"](), 1, tmp_path / "weights.npz", begun.append)
    assert begun[0] == 0


@pytest.mark.parametrize("policy_id", LEARNED)
def test_the_weights_of_every_learned_policy_are_there_and_small(policy_id: str) -> None:
    assert 0 < len(trainings.committed_weights(policy_id)) <= LARGEST_BYTES


def test_files_depend_on_their_arrays_alone() -> None:
    arrays = {"b": np.arange(3.0), "a": np.array(7)}
    assert weights_bytes(arrays) == weights_bytes(dict(reversed(arrays.items())))


def test_the_reward_is_zhangs() -> None:
    assert reward(0.5, 0.5) == 0.0
    assert reward(0.75, 0.71) == pytest.approx(-(0.25**0.5) - 0.2 * 0.04**0.5)


def test_the_command_writes_the_file_and_says_whether_it_is_what_the_policy_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    monkeypatch.setattr(trainings, "_TRAININGS", TINY)
    out = tmp_path / "new" / "weights.npz"
    done = CliRunner().invoke(app, ["zhang2024", "--seed", "3", "--out", str(out)])
    assert done.exit_code == 0 and "other than the weights that zhang2024 has" in done.output
    monkeypatch.setattr(trainings, "files", lambda _package: {learned: out.parent}[learned])
    out.rename(out.with_name("zhang2024.npz"))
    done = CliRunner().invoke(app, ["zhang2024", "--seed", "3", "--out", str(out)])
    assert "the same as the weights that zhang2024 has" in done.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["zang2024"], "there is no policy 'zang2024'; did you mean zhang2024"),
        (["neves2009"], "policy neves2009 has nothing to learn: choose one of berthold2013"),
        (["zhang2024", "--out", "/proc/none/weights.npz"], "/proc/none/weights.npz: cannot be written"),
        (["zhang2024", "--out", "/proc"], "/proc: cannot be written .it is a folder."),
    ],
)
def test_what_cannot_be_done_gets_one_sentence(
    arguments: list[str], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1 and isinstance(result.exception, AutoexposeError | ConfigurationError)
    assert words.replace(".it is a folder.", "(it is a folder)") in str(result.exception)


def test_a_disk_that_is_full_midway_ends_with_a_sentence_and_keeps_what_was_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fill(_done: int) -> None:
        monkeypatch.setattr(os, "fsync", full)

    with pytest.raises(AutoexposeError, match=r"weights.npz: cannot be written .No space left on device.: choose"):
        train(TINY["berthold2013"](), 1, tmp_path / "weights.npz", fill)
    assert [path.name for path in tmp_path.iterdir()] == ["weights.npz.part"]
