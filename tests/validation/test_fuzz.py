"""Who judges inputs tells what is wrong with reading them: errors, endless loops, greed, death."""

import os
import signal

import pytest

from validation.file_fuzzing import judgement
from validation.file_fuzzing.judgement import ACCEPTED, REFUSED, judge, judge_apart
from wrapjax.errors import InputError, Problem

# JAX warns of every fork; nothing of it runs in these.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork")


def refuse(*problems):
    raise InputError(problems)


def fail():
    raise KeyError("a")


def hang():
    while True:
        pass


@pytest.mark.parametrize("judged", [judge, judge_apart])
@pytest.mark.parametrize(
    ("read", "outcome"),
    [
        (lambda: None, ACCEPTED),
        (lambda: refuse(Problem("a.sto", "is empty")), REFUSED),
        (lambda: refuse(), "refused without a sentence"),
        (fail, "KeyError at nowhere of ours"),
        (hang, "longer than 0.2 s at nowhere of ours"),
    ],
    ids=["read", "refused", "silent", "error", "endless"],
)
def test_what_becomes_of_an_input(judged, read, outcome, monkeypatch):
    monkeypatch.setattr(judgement, "LONGEST_S", 0.2)
    assert judged(read).outcome == outcome


def test_a_process_that_dies_is_told():
    assert judge_apart(lambda: os.kill(os.getpid(), signal.SIGKILL)).outcome == "the process ended by SIGKILL"


def test_greed_is_told():
    found = judge_apart(lambda: bytearray(2 * judgement.ROOM))
    assert found.finding and found.outcome.startswith("MemoryError")
