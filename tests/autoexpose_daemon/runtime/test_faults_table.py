"""docs/faults.md: every fault has its row, and every row names tests and counts that exist."""

from __future__ import annotations

import dataclasses
import re

import pytest

from autoexpose_daemon.status.counters import Counts
from drivers.triggers.outcomes import LossReason
from tests import REPOSITORY

PAGE = REPOSITORY / "docs" / "faults.md"
COLUMNS = ["fault", "what happens", "what the user sees", "counted", "test"]
FAULTS = [
    *("camera lost", "camera back", "replaced by another serial", "camera cannot be driven"),
    *("trigger stopped", "trigger doubled", "trigger halved"),
    *("half the packets lost", "frame truncated", "chunk missing", "hostile packets"),
    *("node refuses a write", "node clips", "node sticks", "exposure frozen", "one camera's clock jumps"),
    *("images all black, all white", "NaN-making inputs"),
    *("response file missing", "response file wrong", "response file edited while running", "configuration garbage"),
    *("disk full while recording", "consumer stuck", "SIGSTOP for 5 s", "SIGKILL"),
]
COUNTS = {str(reason) for reason in LossReason} | {field.name for field in dataclasses.fields(Counts)}


def rows() -> list[dict[str, str]]:
    cells = [
        [cell.strip() for cell in line.strip("|").split(" | ")] for line in PAGE.read_text().splitlines() if "|" in line
    ]
    return [dict(zip(COLUMNS, row, strict=True)) for row in cells if row != COLUMNS and not row[0].startswith("---")]


ROWS = rows()


def test_every_fault_has_its_row() -> None:
    assert set(FAULTS) <= {row["fault"].partition(":")[0] for row in ROWS}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row["fault"]))
def test_a_row_is_complete_and_names_tests_and_counts_that_exist(row: dict[str, str]) -> None:
    assert all(row.values())
    assert set(re.findall(r"`(\w+)`", row["counted"])) <= COUNTS
    tests = re.findall(r"\[(\w+)\]::(\w+)", row["test"])
    assert len(tests) == row["test"].count("::")
    assert tests
    for file, name in tests:
        (path,) = re.findall(rf"^\[{file}\]: (\S+)$", PAGE.read_text(), re.MULTILINE)
        assert re.search(rf"^def {name}\(", (PAGE.parent / path).read_text(), re.MULTILINE), f"{file}::{name}"
