"""Parallel jobs in processes on this machine, by a dask scheduler, or on a SLURM cluster.

A job that fails does not stop the others.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from wrapjax.errors import InputError, Problem
from wrapjax.jax_setup import THREAD_VARIABLES

#: Value of ``scheduler`` for jobs of a SLURM cluster, as configured for dask-jobqueue.
SLURM = "slurm"
#: Number of further attempts of a job that failed or whose worker process died.
RETRIES = 1
_CONNECTION_TIMEOUT_S = 20


@dataclass(frozen=True)
class Finished:
    """Finished job.

    Parameters
    ----------
    name
        Name of the job.
    value
        Result; None if the job failed.
    failure
        Error message; empty if the job succeeded.
    """

    name: str
    value: Any
    failure: str = ""


def run_jobs(
    work: Callable[[Any], Any], jobs: Mapping[str, Any], *, scheduler: str | None = None, workers: int = 2
) -> Iterator[Finished]:
    """Run jobs in processes of one thread each, and yield them as they finish.

    Parameters
    ----------
    work
        Function that takes a job and returns its result; a function of a module, so that it can be pickled.
    jobs
        Jobs by name; they must be picklable.
    scheduler
        Address of a dask scheduler (``tcp://host:8786``), or ``slurm``; by default processes on this machine.
    workers
        Number of processes; with an address, those of that scheduler are used instead.

    Yields
    ------
    Finished
        One for each job. A job that raises an error or whose worker dies is tried once more.

    Raises
    ------
    InputError
        If no scheduler answers at the address, or jobs of SLURM are not configured.
    """
    import dask
    from distributed import as_completed

    settings = {
        "distributed.scheduler.allowed-failures": RETRIES,
        # A worker holds no job but the running one: others would wait for it, and count as failed if it died.
        # Dask applies this only to groups of tasks, hence the tuples as keys.
        "distributed.scheduler.worker-saturation": 1.0,
    }
    with (
        dask.config.set(settings),
        _client(scheduler, min(workers, len(jobs))) as client,
    ):
        run = f"run-{uuid4().hex}"  # Unique, so that results of an earlier call are never used.
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
                yield Finished(name, None, _error_message(future))


def _error_message(future: Any) -> str:
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
            client = Client(scheduler, timeout=_CONNECTION_TIMEOUT_S)
        except (OSError, ValueError) as error:
            message = f"no dask scheduler answers at this address ({error})"
            raise InputError(Problem(scheduler, message, hint="start one with 'dask scheduler'")) from error
        with client:
            yield client


def _local(workers: int) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",  # Any free port: other clusters may run on this machine.
        # No limit: a worker that dask restarts for its memory use would lose its job.
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
