"""A training in rounds, kept after each, so that an interrupted one continues and ends with the same bytes."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Protocol
from zipfile import BadZipFile

import numpy as np

from documents.files import replace_file
from evaluation.training.weights_file import Arrays, weights_bytes
from imaging.errors import AutoexposeError


class Training(Protocol):
    """How the weights of one policy are made."""

    @property
    def policy_id(self) -> str:
        """Whose."""

    @property
    def rounds(self) -> int:
        """How many; each has random numbers of its own, so that none depends on where others were stopped."""

    def begin(self, rng: np.random.Generator) -> Arrays:
        """The state before the first round."""

    def proceed(self, state: Arrays, number: int, rng: np.random.Generator) -> None:
        """Change the state by one round."""

    def finish(self, state: Arrays, seed: int) -> Arrays:
        """The arrays of the file of weights."""


def train(training: Training, seed: int, file: Path, advance: Callable[[int], None]) -> bytes:
    """Train, write the weights, and return them.

    Parameters
    ----------
    training
        How.
    seed
        Of all random numbers.
    file
        Where the weights go. What was done before an interruption is beside it, with the ending `.part`.
    advance
        Called with the number of finished rounds, at first with those of before.

    Raises
    ------
    AutoexposeError
        When a file cannot be written.
    """
    part = file.with_name(file.name + ".part")
    key = _key(training, seed)
    state, done = _resumed(part, key) or (training.begin(np.random.default_rng([seed, 0])), 0)
    try:
        _write_part(part, key, state, done)
        advance(done)
        for number in range(done, training.rounds):
            training.proceed(state, number, np.random.default_rng([seed, 1 + number]))
            _write_part(part, key, state, number + 1)
            advance(number + 1)
        content = weights_bytes(training.finish(state, seed))
        replace_file(file, content)
        part.unlink()
    except OSError as error:
        raise AutoexposeError(f"{file}: cannot be written ({error.strerror}): choose another --out") from None
    return content


def _key(training: Training, seed: int) -> str:
    """Changes with whatever the weights depend on and we know: another training must not continue this one."""
    state = hashlib.sha256(f"{training!r} {seed} {np.__version__}".encode())
    for package in ("evaluation.training", "autoexpose_daemon.control.policies.learned"):
        for each in sorted(files(package).iterdir(), key=lambda entry: entry.name):
            if each.name.endswith(".py"):
                state.update(each.read_bytes())
    return state.hexdigest()


def _resumed(part: Path, key: str) -> tuple[Arrays, int] | None:
    """The state after an interruption and its finished rounds; None for that of another training, or a damaged one."""
    try:
        with np.load(io.BytesIO(part.read_bytes()), allow_pickle=False) as kept:
            arrays = dict(kept)
        if arrays.pop("_key").item() != key:
            return None
        return arrays, int(arrays.pop("_done").item())
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None


def _write_part(part: Path, key: str, state: Arrays, done: int) -> None:
    replace_file(part, weights_bytes({**state, "_key": np.array(key), "_done": np.array(done)}))
