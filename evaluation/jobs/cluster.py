"""Work on a cluster of Dask: workers may die, come late, or have another version; no result depends on it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2

from autoexpose_daemon.own_policy.installed import register_policies
from drivers.host import keep_freed_memory
from evaluation.jobs.kept import code_version, libraries
from imaging.errors import AutoexposeError, ConfigurationError

try:
    from distributed import CancelledError, Client, Future, KilledWorker, as_completed, get_worker
except ModuleNotFoundError as error:
    raise ConfigurationError("--cluster needs Dask: pip install 'autoexpose-lab[cluster]'") from error

Item = TypeVar("Item")
Result = TypeVar("Result")

log = logging.getLogger(__name__)

ANSWER_S = 10.0
MOST_DEATHS = 10
"""Dask gives up on work that was there when four workers died; so often it is asked for again."""

_ONE_AT_A_TIME = threading.Lock()  # whatever a worker's number of threads: courses are not for two threads at once


@dataclass(frozen=True, slots=True)
class Refusal:
    """A worker that would get other results, and why."""

    worker: str
    why: str


def connected(address: str) -> Client:
    """A client of the scheduler at an address, such as `tcp://10.0.0.5:8786`.

    Raises ConfigurationError when none answers there.
    """
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # says in tracebacks what is said here in a sentence
    try:
        return Client(address, timeout=ANSWER_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigurationError(
            f"--cluster {address}: no scheduler of Dask answers there: start one with `dask scheduler`, and give the "
            "address that it prints"
        ) from error


def check_cluster(address: str) -> None:
    """Raise as `connected` does."""
    connected(address).close()


def over_cluster(address: str, work: Callable[[Item], Result], items: Sequence[Item]) -> Generator[tuple[Item, Result]]:
    """Apply `work`, which must pickle, to every item; yields each with its result, in order of completion.

    A worker whose code or libraries differ is refused with a warning, and what it had goes to others. Raises
    AutoexposeError when no other is left, when work takes worker after worker with it, or when the scheduler is gone.
    """
    client = connected(address)
    refused: set[str] = set()
    deaths = [0] * len(items)
    version = code_version(), libraries()

    def asked(number: int) -> Future[Any]:
        left = [worker for worker in client.scheduler_info(n_workers=-1)["workers"] if worker not in refused]
        if refused and not left:
            raise AutoexposeError(
                "no worker of the cluster has this version of code and libraries: install the same everywhere"
            )
        only = left if refused else None
        return client.submit(_at_worker, work, items[number], version, pure=False, workers=only)

    try:
        numbers = {asked(number): number for number in range(len(items))}
        waiting = as_completed(numbers, loop=client.loop)
        for future in waiting:
            number = numbers.pop(future)
            try:
                result = future.result()
            except KilledWorker as error:
                deaths[number] += 1
                if deaths[number] > MOST_DEATHS:
                    raise AutoexposeError(
                        "the same work was there each time that a worker of the cluster died, last "
                        f"{error.last_worker}: is its memory enough?"
                    ) from error
                result = None
            if isinstance(result, Refusal):
                if result.worker not in refused:
                    refused.add(result.worker)
                    log.warning("worker %s of the cluster is refused: it has %s", result.worker, result.why)
                result = None
            if result is None:
                again = asked(number)
                numbers[again] = number
                waiting.add(again)
            else:
                yield items[number], result[0]
    except (CancelledError, OSError) as error:
        raise AutoexposeError("the scheduler of the cluster is gone: the same command goes on where it was") from error
    finally:
        client.close()


def _at_worker(work: Callable[[Item], Result], item: Item, version: tuple[str, str]) -> tuple[Result] | Refusal:
    """At a worker: the result in a tuple."""
    code, wanted = version
    register_policies()
    if (found := libraries()) != wanted:
        return Refusal(get_worker().address, f"{found}, not {wanted}")
    if code_version() != code:
        return Refusal(get_worker().address, "other code")
    with _ONE_AT_A_TIME:
        cv2.setNumThreads(1)
        keep_freed_memory()
        return (work(item),)
