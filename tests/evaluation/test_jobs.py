"""Jobs on a cluster of Dask, made of real processes: the same results, whatever happens to workers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from autoexpose_daemon.control import _native
from benchmarks.bench_rejudge import local_cluster
from evaluation.jobs import cluster, kept
from evaluation.jobs.job import Job
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import here, run_jobs, workers_of
from imaging.errors import AutoexposeError, ConfigurationError
from tests.evaluation.cluster_jobs import dies_first, roots

pytestmark = pytest.mark.wire

JOBS = [Job(roots, {"numbers": [n + 0.1, n / 3.0]}, float(n)) for n in range(12)]


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Of a scheduler with two workers."""
    with local_cluster(2, threads=2) as at:
        yield at


def test_a_cluster_gives_what_this_machine_gives(address: str, tmp_path: Path) -> None:
    def run(cluster: str | None) -> list[object]:
        return [*run_jobs(JOBS, ResultCache(tmp_path / str(cluster is None)), workers_of(2, cluster), lambda *_: None)]

    assert run(address) == run(None)
    for file in (tmp_path / "True").rglob("*.json"):
        assert (tmp_path / "False" / file.relative_to(tmp_path / "True")).read_bytes() == file.read_bytes()


def test_workers_have_one_thread_of_opencv(address: str) -> None:
    ((_, threads),) = cluster.over_cluster(address, lambda numbers: roots(numbers, threads=True), [[4.0]])
    assert threads == [2.0, 1.0]


def test_what_a_dying_worker_had_is_done_again(address: str, tmp_path: Path) -> None:
    marks = tmp_path / "marks"
    marks.mkdir()
    jobs = [*JOBS, Job(dies_first, {"marks": str(marks), "times": 5})]  # more often than Dask itself tries
    found = run_jobs(jobs, ResultCache(tmp_path / "kept"), workers_of(1, address), lambda *_: None)
    assert found == [*run_jobs(JOBS, ResultCache(tmp_path / "here"), here(1), lambda *_: None), 5]


def test_workers_of_another_version_are_refused(
    address: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(cluster, "code_version", lambda: "another")
    with pytest.raises(AutoexposeError, match="no worker of the cluster has this version"):
        list(cluster.over_cluster(address, roots, [[4.0], [9.0]]))
    assert caplog.messages and all("is refused: it has other code" in said for said in caplog.messages)
    monkeypatch.setattr(cluster, "libraries", lambda: "numpy 1.0")
    with pytest.raises(AutoexposeError, match="no worker"):
        list(cluster.over_cluster(address, roots, [[4.0]]))
    assert "not numpy 1.0" in caplog.messages[-1]


def test_a_dead_address_is_told_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "ANSWER_S", 0.2)
    for address in ("tcp://127.0.0.1:1", "nonsense://x"):
        with pytest.raises(ConfigurationError, match=f"--cluster {address}.*dask scheduler"):
            workers_of(1, address)


def test_files_count_by_what_is_in_them(tmp_path: Path) -> None:
    cache, keys = ResultCache(tmp_path), []
    files = [("a", b"1", 1), ("b", b"1", 1), ("c", b"2", 1), ("d", b"1", 1 << 27), ("e", b"2", 1 << 27)]
    for name, content, size in files:
        with (tmp_path / name).open("wb") as file:
            file.write(content)
            file.truncate(size)
        keys.append(cache.key(Job(roots, {"numbers": str(tmp_path / name)}, files=("numbers",))))
    assert keys[0] == keys[1] and len({*keys}) == 4
    with pytest.raises(AutoexposeError, match="nowhere cannot be read"):
        cache.key(Job(roots, {"numbers": str(tmp_path / "nowhere")}, files=("numbers",)))


def test_where_no_c_is_installed_the_built_extension_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "ROOT", tmp_path)
    assert kept._c_files([]) == [Path(_native.__file__)]
