"""Outcomes of fuzzed inputs: errors, time and memory limits, and crashes are findings."""

import os
import signal

import pytest

from validation.file_fuzzing import judgement
from validation.file_fuzzing.judgement import ACCEPTED, REFUSED, judge, judge_in_process
from wrapjax.errors import InputError, Problem

# JAX warns of every fork; these processes do not use it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork")


def refuse(*problems):
    raise InputError(problems)


def fail():
    raise KeyError("a")


def hang():
    while True:
        pass


@pytest.mark.parametrize("judge_input", [judge, judge_in_process])
@pytest.mark.parametrize(
    ("read", "outcome"),
    [
        (lambda: None, ACCEPTED),
        (lambda: refuse(Problem("a.sto", "is empty")), REFUSED),
        (lambda: refuse(), "rejected without a message"),
        (fail, "KeyError at outside wrapjax"),
        (hang, "longer than 0.2 s at outside wrapjax"),
    ],
    ids=["read", "rejected", "no message", "error", "endless"],
)
def test_outcome_of_an_input(judge_input, read, outcome, monkeypatch):
    monkeypatch.setattr(judgement, "LONGEST_S", 0.2)
    assert judge_input(read).outcome == outcome


def test_crash_of_the_process_is_a_finding():
    assert (
        judge_in_process(lambda: os.kill(os.getpid(), signal.SIGKILL)).outcome
        == "the process ended by SIGKILL"
    )


def test_excessive_memory_is_a_finding():
    result = judge_in_process(lambda: bytearray(2 * judgement.MEMORY_LIMIT))
    assert result.finding and result.outcome.startswith("MemoryError")
