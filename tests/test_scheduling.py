"""Work done elsewhere comes back by name; what fails, or takes its process with it, stops nothing else."""

import math
import operator
import os

import pytest

from wrapjax.errors import InputError
from wrapjax.scheduling import RETRIES, SLURM, run_everywhere


def collected(*arguments, **options):
    found = list(run_everywhere(*arguments, **options))
    assert len({one.name for one in found}) == len(found)
    return {one.name: (one.value, one.failure) for one in found}


def test_one_failure_stops_no_other():
    jobs = {"four": 4.0, "below zero": -1.0, "nine": 9.0}
    found = collected(math.sqrt, jobs, workers=1)
    assert found["four"] == (2.0, "") and found["nine"] == (3.0, "")
    value, failure = found["below zero"]
    assert value is None and failure.startswith("ValueError: ")


def test_a_worker_that_dies_is_replaced():
    found = collected(operator.methodcaller("__call__"), {"dies": Death(), "lives": Life()}, workers=1)
    assert found["lives"][1] == ""
    assert found["dies"] == (None, f"its worker process died {RETRIES + 1} times: killed, or out of memory")


class Death:
    def __call__(self):
        os._exit(1)


class Life:
    def __call__(self):
        return os.environ["OMP_NUM_THREADS"], os.getpid()


def test_workers_are_other_processes_of_one_thread():
    (threads, process), _ = collected(operator.methodcaller("__call__"), {"own": Life()}, workers=1)["own"]
    assert threads == "1" and process != os.getpid()


def test_no_scheduler(monkeypatch):
    monkeypatch.setattr("wrapjax.scheduling._CONNECTING_S", 0.2)
    with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:9: no dask scheduler answers"):
        collected(math.sqrt, {"four": 4.0}, scheduler="tcp://127.0.0.1:9")


def test_slurm_without_its_package(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "dask_jobqueue", None)
    with pytest.raises(InputError, match="needs dask-jobqueue, which is not installed"):
        collected(math.sqrt, {"four": 4.0}, scheduler=SLURM)


def test_another_cluster_on_this_machine_is_no_hindrance():
    """Two at once: both have servers, and a warning of either is an error here."""
    outer = run_everywhere(math.sqrt, {"four": 4.0, "nine": 9.0}, workers=1)
    first = next(outer)
    assert collected(math.sqrt, {"one": 1.0}, workers=1) == {"one": (1.0, "")}
    assert {first.value, next(outer).value} == {2.0, 3.0}
    outer.close()
