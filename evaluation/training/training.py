"""A training in rounds, resumed after an interruption, and weights whose bytes follow from their arrays alone."""

from __future__ import annotations

import errno
import hashlib
import io
import tempfile
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol
from zipfile import ZIP_STORED, BadZipFile, ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.learned.net import AXES, MARGIN, WEIGHTS_FORMAT, LearntRange
from documents.files import replace_file
from evaluation.arrays import Floats32
from imaging.errors import AutoexposeError

Arrays = dict[str, NDArray[Any]]
LARGEST_BYTES = 200_000  # Of a committed file


def weights_bytes(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """An npz of arrays: uncompressed, in the order of their names, without the date."""
    buffer = io.BytesIO()
    with ZipFile(buffer, "w", ZIP_STORED) as archive:
        for name in sorted(arrays):
            entry = ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(arrays[name], order="C"), version=(1, 0), allow_pickle=False)
            archive.writestr(entry, content.getvalue())
    return buffer.getvalue()


def make_writable(file: Path) -> None:
    """Create the folder of a file and try it; AutoexposeError before minutes of work, not after."""
    try:
        if file.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=file.parent):
            pass
    except OSError as error:
        raise AutoexposeError(f"{file}: cannot be written ({error.strerror}): choose another --out") from None


def net_arrays(layers: list[tuple[NDArray[Any], NDArray[Any]]], inputs: Floats32, seed: int) -> Arrays:
    """What a file of weights holds: the layers of the net, and the range of inputs (rows, of the training)."""
    arrays: Arrays = {"format": np.array(WEIGHTS_FORMAT), "seed": np.array(seed)}
    for place, (matrix, offsets) in enumerate(layers):
        arrays[f"matrix{place}"] = np.asarray(matrix, np.float32)
        arrays[f"offsets{place}"] = np.asarray(offsets, np.float32)
    return arrays | range_arrays(inputs)


def range_arrays(inputs: Floats32) -> Arrays:
    """The range of what was learnt, from some inputs of the training, shape (rows, inputs)."""
    rows = inputs.astype(np.float64)
    centre = rows.mean(axis=0)
    apart = rows - centre
    _, vectors = np.linalg.eigh(apart.T @ apart / len(rows))
    axes = vectors[:, ::-1][:, :AXES].T
    along = apart @ axes.T
    left_over = np.linalg.norm(apart - along @ axes, axis=1)
    deviations = np.append(along.std(axis=0), np.sqrt(np.mean(left_over**2))) + 1e-6
    middle, reach = (rows.max(axis=0) + rows.min(axis=0)) / 2, MARGIN * np.ptp(rows, axis=0) / 2
    arrays: Arrays = {
        "lowest": (middle - reach).astype(np.float32),
        "highest": (middle + reach).astype(np.float32),
        "centre": centre.astype(np.float32),
        "axes": axes.astype(np.float32),
        "deviations": deviations.astype(np.float32),
        "furthest": np.array(np.inf),
    }
    known = LearntRange.of(arrays)
    furthest = max(known.distance(row) for row in rows)
    return arrays | {"furthest": np.array(MARGIN * furthest, np.float32)}


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
    """Train, write the weights, and return them. `training`: how. `seed`: of all random numbers. `file`: where the
    weights go. What was done before an interruption is beside it, with the ending `.part`. `advance`: called with the
    number of finished rounds, at first with those of before. Raises AutoexposeError when a file cannot be written."""
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
