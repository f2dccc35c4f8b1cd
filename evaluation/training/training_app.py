"""The command `autoexpose train`."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from autoexpose_daemon.control.policies.ids import LEARNED, check_policy_id
from evaluation.long_runs import LongProgress
from imaging.errors import AutoexposeError, ConfigurationError

if TYPE_CHECKING:
    from evaluation.training.training import Training


def train_command(
    policy: Annotated[str, typer.Argument(help=f"One of {', '.join(LEARNED)}.")],
    *,
    seed: Annotated[int, typer.Option(min=0, help="Of all random numbers.")] = 0,
    out: Annotated[Path | None, typer.Option(help="File to write; by default out/training/POLICY.npz.")] = None,
) -> None:
    """Train a learned policy on simulated scenes, on one core; the same command resumes an interrupted training."""
    check_policy_id(policy)
    if policy not in LEARNED:
        raise ConfigurationError(f"policy {policy} has nothing to learn: choose one of {', '.join(LEARNED)}")
    file = out or Path("out", "training", f"{policy}.npz")
    # Before numpy is loaded: its sums, and so the bytes, must not depend on how many cores there are.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    from evaluation.training.training import make_writable  # noqa: PLC0415
    from evaluation.training.trainings import committed_weights, training_of  # noqa: PLC0415

    make_writable(file)
    begun_s = time.monotonic()
    content = _train(training_of(policy), seed, file)
    same = "the same as" if content == committed_weights(policy) else "other than"
    minutes = (time.monotonic() - begun_s) / 60
    typer.echo(f"{file}: {len(content)} bytes in {minutes:.1f} min, {same} the weights that {policy} has")


def _train(training: Training, seed: int, file: Path) -> bytes:
    from evaluation.training.training import train  # noqa: PLC0415

    try:
        with LongProgress(Console(), 600.0) as progress:
            bar = progress.add_task(training.policy_id, total=training.rounds)
            advance: Callable[[int], None] = lambda done: progress.update(bar, completed=done)  # noqa: E731
            return train(training, seed, file, advance)
    except KeyboardInterrupt:
        raise AutoexposeError(
            f"the training was stopped before it was done: the same command resumes from {file}.part"
        ) from None
