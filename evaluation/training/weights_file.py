"""Files of weights whose bytes follow from their arrays alone, and the range of what was learnt."""

from __future__ import annotations

import errno
import io
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import ZIP_STORED, ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.learned.net import AXES, MARGIN, WEIGHTS_FORMAT, LearntRange
from imaging.errors import AutoexposeError

Arrays = dict[str, NDArray[Any]]

LARGEST_BYTES = 200_000
"""Of a committed file."""


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


def net_arrays(layers: list[tuple[NDArray[Any], NDArray[Any]]], inputs: NDArray[np.float32], seed: int) -> Arrays:
    """What a file of weights holds: the layers of the net, and the range of inputs (rows, of the training)."""
    arrays: Arrays = {"format": np.array(WEIGHTS_FORMAT), "seed": np.array(seed)}
    for place, (matrix, offsets) in enumerate(layers):
        arrays[f"matrix{place}"] = np.asarray(matrix, np.float32)
        arrays[f"offsets{place}"] = np.asarray(offsets, np.float32)
    return arrays | range_arrays(inputs)


def range_arrays(inputs: NDArray[np.float32]) -> Arrays:
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
