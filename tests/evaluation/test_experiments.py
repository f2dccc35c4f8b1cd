"""The machinery of experiments: work over processes, results that are kept, judged and reported."""

from __future__ import annotations

import io
import json
import math
import os
import select
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from evaluation.experiments import experiments_app
from evaluation.experiments.drives.drives import measure_policies
from evaluation.experiments.experiment import Claim, Experiment, Figure, ReportSection, Results, Table, Verdict
from evaluation.experiments.experiments_app import count_of_verdicts, write_experiments_report
from evaluation.experiments.experiments_app import experiments_app as app
from evaluation.intervals import clustered, mean_interval, pearson
from evaluation.jobs import kept as kept_results
from evaluation.jobs.job import Job, Plain
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import here, run_jobs
from evaluation.long_runs import LongProgress
from evaluation.pool import over_processes
from imaging.errors import AutoexposeError

CALLS: list[int] = []


def square(number: int) -> Plain:
    CALLS.append(number)
    return {"square": number**2, "nothing": math.nan}


def fails(number: int) -> Plain:
    raise ValueError(f"{number} is refused")


def test_results_are_kept_and_come_in_the_order_of_their_jobs(tmp_path: Path) -> None:
    CALLS.clear()
    jobs = [Job(square, {"number": n}, cost_s=n) for n in (2, 5, 3)]
    reported: list[tuple[int, bool]] = []

    def advance(job: Job, took_s: float) -> None:
        reported.append((jobs.index(job), took_s > 0))

    first = run_jobs(jobs, ResultCache(tmp_path), here(1), advance)
    assert CALLS == [5, 3, 2]  # the long ones first
    again = run_jobs(jobs, ResultCache(tmp_path), here(1), advance)
    assert CALLS == [5, 3, 2]
    assert [r["square"] for r in first if isinstance(r, dict)] == [4, 25, 9]
    assert repr(first) == repr(again)
    assert reported == [(1, True), (2, True), (0, True), (0, False), (1, False), (2, False)]


def test_a_failed_run_resumes_where_it_was(tmp_path: Path) -> None:
    CALLS.clear()
    kept = ResultCache(tmp_path)
    with pytest.raises(ValueError, match="1 is refused"):
        run_jobs([Job(square, {"number": 7}, 2.0), Job(fails, {"number": 1})], kept, here(1), lambda _job, _took: None)
    run_jobs([Job(square, {"number": 7}, 2.0)], kept, here(1), lambda _job, _took: None)
    assert CALLS == [7]


def test_equal_jobs_run_once(tmp_path: Path) -> None:
    CALLS.clear()
    jobs = [Job(square, {"number": n}) for n in (4, 6, 4)]
    found = run_jobs(jobs, ResultCache(tmp_path), here(1), lambda _job, _took: None)
    assert [r["square"] for r in found if isinstance(r, dict)] == [16, 36, 16]
    assert sorted(CALLS) == [4, 6]


def test_a_result_that_cannot_be_saved_ends_the_run_with_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "jobs").write_text("a file where a folder should be")
    with pytest.raises(AutoexposeError, match="the result cannot be saved"):
        ResultCache(tmp_path / "jobs").put(Job(square, {"number": 2}), 4)


JOBS = {
    policies: Job(measure_policies, {}, policies=policies)
    for policies in (("begin2022",), ("mehta2020",), ("zhang2024",), ("belief",), None)
}


def keys() -> dict[tuple[str, ...] | None, str]:
    kept_results._digest.cache_clear()
    found = {policies: ResultCache(Path("anywhere")).key(job) for policies, job in JOBS.items()}
    kept_results._digest.cache_clear()
    return found


@pytest.mark.parametrize(
    ("file", "again"),
    [
        ("renderer.py", set(JOBS)),  # reached through imports
        ("gamma.py", {("mehta2020",), None}),  # loaded by its name
        ("zhang2024.npz", {("zhang2024",), None}),
        ("outlook.c", {("belief",), None}),
        ("ids.py", set()),  # another policy in the list changes no result of the others
        ("arena_report.py", set()),
    ],
)
def test_a_job_runs_again_when_code_that_it_reaches_changes(
    file: str, again: set[tuple[str, ...] | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    before, read = keys(), Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b" " * (path.name == file))
    after = keys()
    assert {policies for policies in JOBS if before[policies] != after[policies]} == again


def test_another_default_changes_all_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """Quick runs and tables may ask for it."""
    before = keys()
    monkeypatch.setattr(kept_results, "DEFAULT_POLICY", "begin2022")
    assert not set(before.values()) & set(keys().values())


def test_a_result_is_kept_for_its_job_alone(tmp_path: Path) -> None:
    kept, job = ResultCache(tmp_path), Job(square, {"number": 2})
    kept.put(job, 4)
    assert kept.get(job) == (4,) and kept.get(Job(square, {"number": 3})) is None


def test_a_damaged_file_counts_as_none(tmp_path: Path) -> None:
    kept, job = ResultCache(tmp_path), Job(square, {"number": 2})
    kept.put(job, 4)
    (file,) = tmp_path.rglob("*.json")
    file.write_text('{"square"')
    assert kept.get(job) is None


def test_intervals_cover_what_they_estimate() -> None:
    rng = np.random.default_rng(1)
    inside = 0
    for seed in range(40):
        interval = mean_interval(rng.normal(2.0, 1.0, 30), seed)
        inside += interval.low <= 2.0 <= interval.high
    assert inside >= 34
    assert mean_interval([1.0, 1.0, 1.0]).text(".1f", "mm") == "1.0 mm [1.0, 1.0]"


def test_the_correlation_is_that_of_its_definition() -> None:
    x = np.array([[1.0], [2.0], [3.0], [4.0], [5.0], [6.0], [7.0], [8.0]])
    assert pearson(x, np.exp(x)).value == pytest.approx(np.corrcoef(x[:, 0], np.exp(x[:, 0]))[0, 1])
    noisy = pearson(x, -x + np.array([[0.0], [2.5], [0.0], [0.0], [-2.5], [0.0], [0.0], [0.0]]))
    assert noisy.low <= noisy.value < 0 and noisy.low >= -1.0


def test_points_of_one_cluster_count_as_one() -> None:
    """Four copies of each point say no more than one."""
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, 20, 1))
    once, copied = pearson(x, y), pearson(np.repeat(x, 4, axis=1), np.repeat(y, 4, axis=1))
    assert (copied.value, copied.low, copied.high) == pytest.approx((once.value, once.low, once.high))
    rows = clustered(np.repeat(x, 4, axis=1), lambda drawn: drawn.mean(axis=(1, 2)))
    whole = mean_interval(x[:, 0])
    assert (rows.low, rows.high) == pytest.approx((whole.low, whole.high))


def _jobs(_quick: bool) -> list[Job]:
    return []


def _section(_results: list[tuple[Mapping[str, Plain], Plain]], _folder: Path) -> ReportSection:
    raise NotImplementedError


def test_the_report_gives_the_verdicts_first_in_both_forms(tmp_path: Path) -> None:
    claim = Claim("B&H Fig. 0", "a < b", "|1| < 2", Verdict.CONDITIONALLY, "only `here`")
    section = ReportSection(
        "As in the paper, but for `x`.", [claim], [Table("Plain & simple", ["a", "b"], [["1", "2"]]),
        Figure("fig0.png", "The figure")]
    )  # fmt: skip
    path = write_experiments_report([(Experiment("fig0", "Title", _jobs, _section), section)], "Preface.", tmp_path)
    text, page = path.read_text(), path.with_suffix(".html").read_text()
    assert text.index("## Verdicts") < text.index("## fig0: Title")
    assert "1 claim: 0 reproduced, 1 reproduced under conditions, 0 not reproduced." in text
    assert "| `fig0` | B&H Fig. 0 | a < b | \\|1\\| < 2 | **reproduced under conditions**: only `here` |" in text
    assert "| a | b |\n|---|---:|\n| 1 | 2 |" in text and "![The figure](fig0.png)" in text
    assert "a &lt; b" in page and '<b class="conditions">' in page and "<code>x</code>" in page
    assert "Plain &amp; simple" in page and "only <code>here</code>" in page


def test_a_report_of_one_experiment_has_its_title_and_no_empty_table(tmp_path: Path) -> None:
    chapter = (Experiment("worth", "What it is worth", _jobs, _section), ReportSection("Rooms.", [], []))
    path = write_experiments_report([chapter], "Preface.", tmp_path)
    text, page = path.read_text(), path.with_suffix(".html").read_text()
    assert text.startswith("# What it is worth\n") and "<title>What it is worth</title>" in page
    assert "Verdicts" not in text + page
    both = write_experiments_report([chapter, chapter], "Preface.", tmp_path).read_text()
    assert not both.startswith("# What it is worth\n")


def test_only_claims_of_the_papers_are_counted() -> None:
    theirs = Claim("B&H Fig. 0", "a < b", "1 < 2", Verdict.REPRODUCED)
    section = ReportSection("", [theirs, replace(theirs, counted=False), replace(theirs, counted=False)], [])
    said = count_of_verdicts([(Experiment("fig0", "Title", _jobs, _section), section)])
    assert said.startswith("1 claim: 1 reproduced, 0 reproduced under conditions, 0 not reproduced. Not counted: 2 ")


def places(folder: Path) -> tuple[str, ...]:
    """Options by which a run writes below a folder alone."""
    return "--out", str(folder), "--kept", str(folder / "jobs")


def test_the_command_refuses_bad_arguments_before_it_starts_work(tmp_path: Path) -> None:
    for arguments, said in (
        (["run", "fig1"], "say how much: --full takes about a minute with these --jobs, --quick about a minute"),
        (["run", "all", "--jobs", "1"], " hours with these --jobs, --quick about "),
        (["run", "fig1", "--quick", "--full"], "--quick and --full exclude each other"),
        (["run", "fig99"], "there is no experiment 'fig99': choose all, or from fig1"),
        (["run", "fig1", "--quick", "--out", str(tmp_path / "file" / "out")], "choose another --out"),
        (["run", "fig1", "--quick", *places(tmp_path), "--kept", str(tmp_path / "file")], "choose another --kept"),
    ):
        (tmp_path / "file").write_text("")
        outcome = CliRunner().invoke(app, arguments)
        assert isinstance(outcome.exception, AutoexposeError) and said in str(outcome.exception)


def test_the_command_writes_the_report_and_again_from_kept_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def section(results: Results, _folder: Path) -> ReportSection:
        seen = ", ".join(str(result["square"]) for _, result in results)
        return ReportSection("Setting.", [Claim("Us", "squares", seen, Verdict.REPRODUCED)], [])

    made = Experiment("squares", "Squares", lambda _quick: [Job(square, {"number": n}) for n in (2, 3)], section)
    monkeypatch.setattr(experiments_app, "EXPERIMENTS", (made,))
    CALLS.clear()
    for _ in range(2):
        outcome = CliRunner().invoke(app, ["run", "all", "--full", "--jobs", "1", *places(tmp_path)])
        assert outcome.exit_code == 0 and "we saw: 4, 9" in outcome.output and "100 %" in outcome.output
        assert "4, 9" in (tmp_path / "experiments.md").read_text()
    assert "all kept from earlier" in outcome.output and sorted(CALLS) == [2, 3]


def test_json_has_the_numbers_of_one_experiment_or_of_several_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def section(_results: Results, _folder: Path) -> ReportSection:
        return ReportSection("Setting.", [], [])

    def names(_results: Results) -> Plain:
        return {"own": "form"}

    jobs = [Job(square, {"number": 2})]
    one = Experiment("one", "One", lambda _quick: jobs, section)
    two = Experiment("two", "Two", lambda _quick: jobs, section, names, in_all=False)
    monkeypatch.setattr(experiments_app, "EXPERIMENTS", (one, two))
    file = tmp_path / "numbers.json"
    generic = {"results": [{"arguments": {"number": 2}, "result": {"square": 4, "nothing": None}}]}
    for given, written in (
        (["one"], generic),
        (["two"], {"own": "form"}),
        (["one", "two"], {"one": generic, "two": {"own": "form"}}),
        (["all"], generic),
    ):
        arguments = ["run", *given, "--quick", "--jobs", "1", *places(tmp_path), "--json", str(file)]
        assert CliRunner().invoke(app, arguments).exit_code == 0
        assert json.loads(file.read_text()) == written


def test_workers_end_with_a_parent_that_is_killed() -> None:
    code = "from tests.evaluation.test_experiments import print_worker; print_worker()"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
    try:
        assert select.select([worker], [], [], 60.0)[0]
    finally:
        os.close(worker)


def print_worker() -> None:
    """Print the id of a process that is then busy for longer than any test."""
    for _, number in over_processes(_number_or_sleep, [0, 600, 600], 2):
        print(number, flush=True)


def _number_or_sleep(seconds: int) -> int:
    time.sleep(seconds)
    return os.getpid()


@pytest.mark.parametrize("terminal", [False, True])
def test_a_line_a_minute_where_there_is_no_terminal(terminal: bool) -> None:
    clock_s = [0.0]
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=100)
    progress = LongProgress(console, 3600.0, lambda: clock_s[0])
    bar = progress.add_task("arena", total=100.0)
    for clock_s[0] in (20.0, 40.0, 60.0, 80.0, 100.0, 120.0):
        progress.update(bar, advance=10.0)
    lines = [] if terminal else ["arena: 30 % after 0:01:00, 0:02:20 left", "arena: 60 % after 0:02:00, 0:01:20 left"]
    assert out.getvalue().splitlines() == lines
