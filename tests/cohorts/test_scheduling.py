"""Parallel jobs: results by name, failures and dead workers that do not stop other jobs."""

import ctypes
import math
import operator
import os
import select
import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from wrapjax.cohorts.scheduling import RETRIES, SLURM, run_jobs
from wrapjax.errors import InputError


def collected(*arguments, **options):
    found = list(run_jobs(*arguments, **options))
    assert len({one.name for one in found}) == len(found)
    return {one.name: (one.value, one.failure) for one in found}


def test_a_failure_does_not_stop_other_jobs():
    jobs = {"four": 4.0, "below zero": -1.0, "nine": 9.0}
    found = collected(math.sqrt, jobs, workers=1)
    assert found["four"] == (2.0, "") and found["nine"] == (3.0, "")
    value, failure = found["below zero"]
    assert value is None and failure.startswith("ValueError: ")


def test_a_file_that_cannot_be_written_is_named():
    found = collected(operator.methodcaller("__call__"), {"full": Full()}, workers=1)
    assert found["full"] == (None, "/results/anna: No space left on device")


class Full:
    def __call__(self):
        raise OSError(28, "No space left on device", "/results/anna")


def test_a_worker_that_dies_is_replaced():
    found = collected(operator.methodcaller("__call__"), {"dies": Crash(), "lives": Report()}, workers=1)
    assert found["lives"][1] == ""
    assert found["dies"] == (None, f"its worker process died {RETRIES + 1} times: killed, or out of memory")


class Crash:
    def __call__(self):
        os._exit(1)


class Report:
    def __call__(self):
        return os.environ["OMP_NUM_THREADS"], os.getpid()


def test_workers_are_other_processes_of_one_thread():
    (threads, process), _ = collected(operator.methodcaller("__call__"), {"own": Report()}, workers=1)["own"]
    assert threads == "1" and process != os.getpid()


@dataclass
class SlowJob:
    """Job that ends when all others have reported, or after a timeout, and holds the interpreter until then.

    Numerical libraries do so too: they answer no messages until they are done.
    """

    letters: Path
    others: int

    def __call__(self):
        box = os.open(self.letters, os.O_RDWR)
        watched = (ctypes.c_int * 2)(box, select.POLLIN)
        heard = 0
        while heard < self.others and ctypes.PyDLL(None).poll(watched, 1, 20_000):
            heard += len(os.read(box, self.others))
        os.close(box)
        return heard


@dataclass
class FastJob:
    letters: Path

    def __call__(self):
        box = os.open(self.letters, os.O_RDWR)
        os.write(box, b".")
        os.close(box)
        return os.getpid()


def test_no_job_waits_for_a_slow_one(tmp_path):
    """Waiting jobs go to free workers; a busy worker holds no other job."""
    letters = tmp_path / "letters"
    os.mkfifo(letters)
    names = [f"other {number}" for number in range(12)]
    jobs = {"patient": SlowJob(letters, len(names)), **dict.fromkeys(names, FastJob(letters))}
    box = os.open(letters, os.O_RDWR)  # A pipe that no process holds open loses its content.
    found = collected(operator.methodcaller("__call__"), jobs, workers=2)
    os.close(box)
    assert found["patient"] == (len(names), "")
    assert len({found[name] for name in names}) == 1


def test_no_scheduler(monkeypatch):
    monkeypatch.setattr("wrapjax.cohorts.scheduling._CONNECTION_TIMEOUT_S", 0.2)
    with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:9: no dask scheduler answers"):
        collected(math.sqrt, {"four": 4.0}, scheduler="tcp://127.0.0.1:9")


def test_workers_of_an_existing_scheduler():
    """The scheduler is used by its address, and still runs afterwards."""
    from distributed import Client, LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        found = collected(
            math.sqrt, {"four": 4.0, "below zero": -1.0}, scheduler=cluster.scheduler_address, workers=7
        )
        assert found["four"] == (2.0, "") and found["below zero"][0] is None
        with Client(cluster.scheduler_address) as client:
            assert len(client.scheduler_info()["workers"]) == 1


def test_slurm_makes_jobs_of_one_thread(monkeypatch):
    """With a substitute for the cluster, whose jobs are local processes."""
    from distributed import LocalCluster

    made = []

    class SLURMCluster(LocalCluster):
        def __init__(self, job_script_prologue):
            made.append(self)
            self.prologue, self.asked = job_script_prologue, []
            super().__init__(n_workers=0, threads_per_worker=1, dashboard_address=None)

        def scale(self, count):
            self.asked.append(count)
            super().scale(count)

    substitute_dask_jobqueue(monkeypatch, SLURMCluster)
    found = collected(operator.methodcaller("__call__"), {"a": Report(), "b": Report()}, scheduler=SLURM)
    assert {failure for _, failure in found.values()} == {""}
    (cluster,) = made
    assert cluster.asked[0] == 2 and cluster.status.name == "closed"
    assert "export OMP_NUM_THREADS=1" in cluster.prologue


def test_slurm_without_settings(monkeypatch):
    def cluster(job_script_prologue):
        raise ValueError("You must specify how many cores to use per job")

    substitute_dask_jobqueue(monkeypatch, cluster)
    with pytest.raises(InputError, match=r"slurm: .*how many cores.*; describe a job in ~/.config/dask"):
        collected(math.sqrt, {"four": 4.0}, scheduler=SLURM)


def substitute_dask_jobqueue(monkeypatch, cluster):
    monkeypatch.setitem(sys.modules, "dask_jobqueue", SimpleNamespace(SLURMCluster=cluster))


def test_slurm_without_its_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "dask_jobqueue", None)
    with pytest.raises(InputError, match="needs dask-jobqueue, which is not installed"):
        collected(math.sqrt, {"four": 4.0}, scheduler=SLURM)


def test_two_clusters_on_one_machine():
    """Both have servers, and any warning is an error here."""
    outer = run_jobs(math.sqrt, {"four": 4.0, "nine": 9.0}, workers=1)
    first = next(outer)
    assert collected(math.sqrt, {"one": 1.0}, workers=1) == {"one": (1.0, "")}
    assert {first.value, next(outer).value} == {2.0, 3.0}
    outer.close()
