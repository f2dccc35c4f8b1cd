"""Each command line of README and docs is executed by a test, or listed with the reason why not: command_lines.yaml."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from tests import REPOSITORY
from tests.command_lines import command_lines, in_order, readmes_rig, table

TABLE = table()


def test_each_is_listed_once_and_no_other() -> None:
    listed = [*TABLE["quick"]]
    for session in TABLE["sessions"].values():
        listed += [line for line in in_order(session["lines"]) if not line.startswith("sleep ")]
    for lines in (*TABLE["elsewhere"].values(), *TABLE["nowhere"].values()):
        listed += lines
    found = {line: at for line, at in command_lines().items() if not line.startswith("sleep ")}
    assert {line: at for line, at in found.items() if line not in listed} == {}, "not in command_lines.yaml"
    assert set(listed) - set(found) == set(), "no longer in README or docs"
    assert [line for line, times in Counter(listed).items() if times > 1] == []


@pytest.mark.parametrize("test", TABLE["elsewhere"])
def test_it_is_there(test: str) -> None:
    file, _, name = test.partition("::")
    assert re.search(rf"^def {name}\(" if name else "^def test_", (REPOSITORY / file).read_text(), re.MULTILINE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("checkout")
    (folder / "examples").symlink_to(REPOSITORY / "examples")
    (folder / "rig.yaml").write_text(readmes_rig())
    return folder


@pytest.mark.parametrize("line", TABLE["quick"])
def test_it_runs(line: str, folder: Path) -> None:
    environment: dict[str, Any] = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    command = ["bash", "-euo", "pipefail", "-c", line]
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
