"""A vocabulary for ORB-SLAM3 from descriptors of our own frames, because its Python package has none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

BRANCHES, LEVELS = 10, 4
"""Ten thousand words at most: enough for a room."""

ROUNDS = 6
"""Of moving each centre to the majority of its nearest descriptors."""


def write_vocabulary(descriptors: NDArray[np.uint8], file: Path, seed: int = 0) -> int:
    """Cluster ORB descriptors (n, 32) into a tree and write it in DBoW2's text format; returns the number of nodes.

    The first line gives branches, levels, L1 score and TF-IDF weights. Each node then has a line, parents first: the
    number of its parent (0: the root, which has no line), whether it is a word, 32 bytes, its weight. Words weigh 1.
    """
    rng = np.random.default_rng(seed)
    lines: list[str] = []
    open_nodes = [(0, 1, np.unpackbits(descriptors, axis=1))]
    while open_nodes:
        parent, level, bits = open_nodes.pop(0)
        centres, nearest = _clusters(bits, rng)
        for number, centre in enumerate(centres):
            members = bits[nearest == number]
            word = level == LEVELS or len(members) < 2
            text = " ".join(map(str, np.packbits(centre)))
            lines.append(f"{parent} {int(word)} {text} {1.0 if word else 0.0}")
            if not word:
                open_nodes.append((len(lines), level + 1, members))
    # A line feed at the end would be read as another node.
    file.write_text(f"{BRANCHES} {LEVELS} 0 0\n" + "\n".join(lines), encoding="ascii")
    return len(lines)


def _clusters(bits: NDArray[np.uint8], rng: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Centres, and the one that each row of bits belongs to, none without rows: k-means with majorities."""
    centres = bits[rng.choice(len(bits), min(BRANCHES, len(bits)), replace=False)]
    nearest = np.zeros(len(bits), np.int64)
    rows = bits.astype(np.float32)
    for _ in range(ROUNDS):
        nearest = (rows @ (1.0 - 2.0 * centres.T) + centres.sum(axis=1)).argmin(axis=1)
        kept = np.unique(nearest)
        centres = np.array([rows[nearest == number].mean(axis=0) >= 0.5 for number in kept], np.uint8)
        nearest = np.searchsorted(kept, nearest)
    return centres, nearest
