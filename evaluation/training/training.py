"""What trainings share: rounds that resume after an interruption, a net that learns, and files of weights."""

from __future__ import annotations

import errno
import hashlib
import io
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from itertools import pairwise
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
    """Train, write the weights, and return them. What was done before an interruption is beside it, with the ending
    `.part`. `advance`: called with the number of finished rounds, at first with those of before. Raises AutoexposeError
    when a file cannot be written."""
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


Batch = Floats32
DECAYS = (np.float32(0.9), np.float32(0.999))  # Of the two moments (Kingma & Ba 2015)
TINY = np.float32(1e-8)


class TrainedNet:
    """``x -> W x + b`` layer by layer, with ReLU after each but the last; float32 throughout, or float64 for tests.
    `arrays`: where weights and moments live, named with `prefix`: of its names in `arrays`."""

    def __init__(self, arrays: Arrays, prefix: str) -> None:
        self._arrays, self._prefix = arrays, prefix
        self._count = sum(name.rpartition("matrix")[0] == f"{prefix}." and name[-1].isdigit() for name in arrays)
        self._seen: list[Batch] = []

    @classmethod
    def begin(cls, arrays: Arrays, prefix: str, sizes: Sequence[int], rng: np.random.Generator) -> TrainedNet:
        """A new net of some sizes, inputs first: He's weights, the last layer's small, so that it begins near 0."""
        for place, (inputs, outputs) in enumerate(pairwise(sizes)):
            scale = np.sqrt(2.0 / inputs) * (0.1 if place == len(sizes) - 2 else 1.0)
            matrix = (scale * rng.standard_normal((outputs, inputs))).astype(np.float32)
            arrays[f"{prefix}.matrix{place}"] = matrix
            arrays[f"{prefix}.offsets{place}"] = np.zeros(outputs, np.float32)
        net = cls(arrays, prefix)
        for name in net.names:
            arrays[f"{name}.first"] = np.zeros_like(arrays[name])
            arrays[f"{name}.second"] = np.zeros_like(arrays[name])
        arrays[f"{prefix}.steps"] = np.array(0)
        return net

    @property
    def names(self) -> list[str]:
        """Its weights in the state."""
        kinds = ("matrix", "offsets")
        return [f"{self._prefix}.{kind}{place}" for place in range(self._count) for kind in kinds]

    @property
    def layers(self) -> list[tuple[Batch, Batch]]:
        """Matrix (outputs, inputs) and offsets (outputs,) of each layer."""
        weights = [self._arrays[name] for name in self.names]
        return list(zip(weights[::2], weights[1::2], strict=True))

    def forward(self, inputs: Batch) -> Batch:
        """Outputs (rows, outputs) for inputs (rows, inputs); kept for `backward`."""
        self._seen = [inputs]
        for matrix, offsets in self.layers[:-1]:
            self._seen.append(np.maximum(self._seen[-1] @ matrix.T + offsets, 0.0))
        matrix, offsets = self.layers[-1]
        return np.asarray(self._seen[-1] @ matrix.T + offsets)

    def backward(self, slopes: Batch) -> tuple[list[Batch], Batch]:
        """Gradients of the weights, in the order of `names`, and of the inputs. `slopes`: of what is to fall, by the
        outputs of the latest `forward`, shape (rows, outputs)."""
        gradients: list[Batch] = []
        for (matrix, _), seen in zip(reversed(self.layers), reversed(self._seen), strict=True):
            gradients = [slopes.T @ seen, slopes.sum(axis=0), *gradients]
            slopes = slopes @ matrix
            if seen is not self._seen[0]:
                slopes = slopes * (seen > 0)
        return gradients, slopes

    def descend(self, gradients: Sequence[Batch], rate: float) -> None:
        """One step of Adam against the gradients."""
        steps = int(self._arrays[f"{self._prefix}.steps"]) + 1
        self._arrays[f"{self._prefix}.steps"] = np.array(steps)
        first_decay, second_decay = DECAYS
        scale = np.float32(rate * np.sqrt(1.0 - float(second_decay) ** steps) / (1.0 - float(first_decay) ** steps))
        for name, gradient in zip(self.names, gradients, strict=True):
            first, second = self._arrays[f"{name}.first"], self._arrays[f"{name}.second"]
            first += (1 - first_decay) * (gradient - first)
            second += (1 - second_decay) * (gradient * gradient - second)
            self._arrays[name] -= scale * first / (np.sqrt(second) + TINY)

    def copy_to(self, prefix: str) -> TrainedNet:
        """A copy of its weights under another prefix, without moments: what follows a net slowly."""
        for name in self.names:
            self._arrays[prefix + name[len(self._prefix) :]] = self._arrays[name].copy()
        return TrainedNet(self._arrays, prefix)

    def follow(self, other: TrainedNet, share: float) -> None:
        """Move the weights a share of the way to those of another net."""
        for own, name in zip(self.names, other.names, strict=True):
            self._arrays[own] += np.float32(share) * (self._arrays[name] - self._arrays[own])
