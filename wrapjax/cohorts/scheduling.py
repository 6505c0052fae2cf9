"""Work spread over processes, here or elsewhere, by dask.distributed. One piece that fails stops no other."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from wrapjax.errors import InputError, Problem
from wrapjax.jax_setup import THREAD_VARIABLES

#: In place of an address: jobs of a SLURM cluster, as dask-jobqueue's own settings describe them.
SLURM = "slurm"
#: How often a piece of work is tried again that failed, or whose worker died.
RETRIES = 1
_CONNECTING_S = 20


@dataclass(frozen=True)
class Finished:
    """A piece of work that came to an end.

    Parameters
    ----------
    name
        Of the piece.
    value
        What it gave; None if it failed.
    failure
        What went wrong, as a sentence; empty if nothing did.
    """

    name: str
    value: Any
    failure: str = ""


def run_jobs(
    work: Callable[[Any], Any], jobs: Mapping[str, Any], *, scheduler: str | None = None, workers: int = 2
) -> Iterator[Finished]:
    """Do pieces of work in processes of one thread each, and yield them as they finish.

    Parameters
    ----------
    work
        What to do with a job; a function of a module, so that other processes find it.
    jobs
        By name; whatever can be pickled.
    scheduler
        Address of a dask scheduler (``tcp://host:8786``), or ``slurm``; by default processes on this machine.
    workers
        How many processes; with an address, as many as that scheduler has.

    Yields
    ------
    Finished
        One a job. What raises an error is tried again once, and so is what its worker died of.

    Raises
    ------
    InputError
        If there is no such scheduler.
    """
    import dask
    from distributed import as_completed

    settings = {
        "distributed.scheduler.allowed-failures": RETRIES,
        # A process holds the piece that it works at and no other, which would wait for it, and be blamed if
        # it died. Dask heeds that for groups of tasks only: see the keys.
        "distributed.scheduler.worker-saturation": 1.0,
    }
    with (
        dask.config.set(settings),
        _client(scheduler, min(workers, len(jobs))) as client,
    ):
        run = f"run-{uuid4().hex}"  # no answer of an earlier call may be taken for this one's
        keys = [(run, name) for name in jobs]
        futures = dict(
            zip(
                client.map(work, list(jobs.values()), key=keys, retries=RETRIES, pure=False),
                jobs,
                strict=True,
            )
        )
        for future in as_completed(list(futures)):
            name = futures.pop(future)
            if future.status == "finished":
                yield Finished(name, future.result())
            else:
                yield Finished(name, None, _sentence(future))


def _sentence(future: Any) -> str:
    from distributed import KilledWorker

    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        return f"its worker process died {RETRIES + 1} times: killed, or out of memory"
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return "it was cancelled" if error is None else f"{type(error).__name__}: {error}"


@contextmanager
def _client(scheduler: str | None, workers: int) -> Iterator[Any]:
    from distributed import Client

    if scheduler is None:
        with _local(workers) as cluster, Client(cluster) as client:
            yield client
    elif scheduler == SLURM:
        with _slurm(workers) as cluster, Client(cluster) as client:
            yield client
    else:
        try:
            client = Client(scheduler, timeout=_CONNECTING_S)
        except (OSError, ValueError) as error:
            message = f"no dask scheduler answers there ({error})"
            raise InputError(Problem(scheduler, message, hint="start one with 'dask scheduler'")) from error
        with client:
            yield client


def _local(workers: int) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",  # any free port: others may have a cluster here, too
        # What is too much for this machine is said by it; a worker that is stopped for it loses its work.
        memory_limit=0,
        silence_logs=logging.CRITICAL,
        env=dict.fromkeys(THREAD_VARIABLES, "1"),
    )


def _slurm(workers: int) -> Any:
    try:
        from dask_jobqueue import SLURMCluster
    except ImportError:
        message = "needs dask-jobqueue, which is not installed"
        raise InputError(Problem(SLURM, message, hint="pip install 'wrapjax[slurm]'")) from None
    try:
        cluster = SLURMCluster(job_script_prologue=[f"export {name}=1" for name in THREAD_VARIABLES])
    except ValueError as error:
        message = f"dask-jobqueue cannot make a job of its settings ({error})"
        hint = "describe a job in ~/.config/dask/jobqueue.yaml"
        raise InputError(Problem(SLURM, message, hint=hint)) from None
    cluster.scale(workers)
    return cluster
