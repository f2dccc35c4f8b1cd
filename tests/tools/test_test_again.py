"""What `make test-again` reads out of a run, and how it sums up many."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

from tools.test_again import Run, read, results, summary

GREEN = Run("2026-11-22T08:00:00+01:00", "abc1234", False, 225.0, 3.6, 2100, 1, [])
OUTPUT = """\
.venv/bin/pytest -m "not realtime" -n 4 --dist loadgroup
ERROR left camera: gone
SKIPPED [1] tests/drivers/host/test_usb.py:79: root may open every node
FAILED tests/autoexpose_daemon/page/test_page.py::test_words[a-b c] - AssertionError: in 3 seconds
ERROR tests/autoexpose_daemon/page/test_page.py::test_other - OSError
============ 1 failed, 2061 passed, 1 skipped, 1 error in 100.31s (0:01:40) ============
.venv/bin/pytest -m realtime
==== 31 passed, 2300 deselected in 60.00s (0:01:00) ====
"""


def test_counts_of_both_parts_add_up_and_failures_have_names() -> None:
    passed, skipped, failed = results(OUTPUT, 2)
    assert (passed, skipped) == (2092, 1)
    assert failed == [
        "tests/autoexpose_daemon/page/test_page.py::test_words[a-b",
        "tests/autoexpose_daemon/page/test_page.py::test_other",
    ]


def test_a_run_that_breaks_off_has_failed() -> None:
    assert results("make: *** [Makefile:66: suite] Killed\n", 137) == (0, 0, ["make ended with 137"])
    assert results("2061 passed in 1.0s\n", 0) == (2061, 0, [])


def test_many_are_summed_up_in_a_sentence() -> None:
    runs = [GREEN, replace(GREEN, seconds=250.4, literal_step_ms=4.0)]
    assert summary(runs) == [
        "2 of 2 green, 3:45 to 4:10, literal step 3.6 to 4.0 ms: at most 70 % of the limit, 6 min x literal step / 4 ms"
    ]


def test_runs_with_a_busy_core_stand_apart_and_failures_are_named() -> None:
    red = replace(GREEN, busy=True, failed=["tests/a.py::test_b"])
    first, second, third = summary([GREEN, red, red, replace(GREEN, busy=True)])
    assert first.startswith("1 of 1 green, ")
    assert second.startswith("1 of 3 green with one core kept busy, ")
    assert third == "failed 2 times: tests/a.py::test_b"


def test_a_log_is_read_back_and_none_is_an_empty_one(tmp_path: Path) -> None:
    log = tmp_path / "log"
    assert read(log) == []
    log.write_text("".join(json.dumps(asdict(run)) + "\n" for run in (GREEN, GREEN)))
    assert read(log) == [GREEN, GREEN]
