"""How the set-up goes on where an earlier one was interrupted, or was root's."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests import REPOSITORY

OWNER = 65534


def program(file: Path, text: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)


@pytest.mark.parametrize(("answer", "steps"), [("exit 0", []), ("exit 1", ["making .venv"])], ids=["whole", "half"])
def test_an_environment_without_pip_is_made_again(tmp_path: Path, answer: str, steps: list[str]) -> None:
    for file in ("Makefile", "pyproject.toml", "setup.py"):
        shutil.copy(REPOSITORY / file, tmp_path)
    program(tmp_path / ".venv/bin/python", answer)
    program(tmp_path / "tools/timed", 'echo "$1" >>steps')
    for tool in ("install-debian", "install-python"):
        program(tmp_path / "tools" / tool, "exit 0")
    (tmp_path / "steps").touch()
    subprocess.run(["make", "-C", tmp_path, ".venv/demo.stamp"], capture_output=True, check=True)
    assert (tmp_path / "steps").read_text().splitlines() == steps


@pytest.mark.skipif(os.geteuid() != 0, reason="only root writes for others")
def test_the_owner_of_a_checkout_can_go_on_with_what_root_leaves(tmp_path: Path) -> None:
    shutil.copytree(REPOSITORY / "tools", tmp_path / "tools")
    os.chown(tmp_path, OWNER, OWNER)
    subprocess.run([tmp_path / "tools/timed", "installing", "true"], capture_output=True, check=True)
    assert [(tmp_path / name).stat().st_uid for name in ("build", "build/setup.log")] == [OWNER, OWNER]
