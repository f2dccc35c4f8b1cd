"""Commands that run to their end, in processes of their own."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from tests import REPOSITORY

NOTHING_ELSE: Mapping[str, str] = MappingProxyType({})


def output(
    *command: object,
    folder: Path = REPOSITORY,
    status: int = 0,
    timeout_s: float | None = None,
    environment: Mapping[str, str] = NOTHING_ELSE,
) -> str:
    """What a command prints, which ends with `status`; the environment of these tests' Python is not its own."""
    ours = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    words = list(map(str, command))
    result = subprocess.run(
        words, cwd=folder, env={**ours, **environment}, capture_output=True, text=True, timeout=timeout_s, check=False
    )
    assert result.returncode == status, result.stdout + result.stderr
    return result.stdout
