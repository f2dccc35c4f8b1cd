"""Training gives the same bytes for the same seed, interrupted or not; and bad input gets one sentence."""

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
from evaluation.training import berthold2013, tomasi2021, trainings, zhang2024
from evaluation.training.berthold2013 import TrainingOfBerthold
from evaluation.training.episode import TrainingPicture
from evaluation.training.tomasi2021 import TrainingOfTomasi
from evaluation.training.training import LARGEST_BYTES, Training, train, weights_bytes
from evaluation.training.training_app import train_command
from evaluation.training.zhang2024 import TrainingOfZhang, reward
from imaging.errors import AutoexposeError, ConfigurationError

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
