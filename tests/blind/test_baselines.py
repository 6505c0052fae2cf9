"""Defends: what a diagnosis is compared with is done as textbooks say, and answers where the scorer looks."""

import json

import numpy as np
import pytest

from benchmarks.baselines import BASELINES, modification_index, write_answer, write_silence
from benchmarks.blind.score.records import read_answer
from wrapjax.gap.evidence.covariance import MuscleErrors
from wrapjax.gap.evidence.linearized import LinearGap
from wrapjax.gap.evidence.score import Candidate

CYCLES, COORDINATES, PHASES, EFFECTS = 6, 2, 10, 12
ROWS = CYCLES * COORDINATES * PHASES


def lines(generator, amount, at_work=3):
    """Independent noise, three calibrated variables, and one effect of this size."""
    slopes = generator.normal(size=(3, ROWS))
    candidates = tuple(
        Candidate(
            f"effect_{number}", (generator.normal(size=(1, ROWS)),), np.ones(1), np.zeros(1, dtype=bool)
        )
        for number in range(EFFECTS)
    )
    residual = generator.normal(size=ROWS) + amount * candidates[at_work].variants[0][0]
    left = residual - slopes.T @ np.linalg.lstsq(slopes.T, residual, rcond=None)[0]
    shape = (CYCLES, COORDINATES, PHASES)
    return LinearGap(
        residual=residual.reshape(shape),
        fitted=left.reshape(shape),
        slopes=slopes.reshape(3, *shape),
        spread=np.eye(3),
        away=np.zeros(3),
        nuisances=np.zeros((0, *shape)),
        candidates=candidates,
        input_errors=(),
        muscle_errors=MuscleErrors(
            np.zeros((1, CYCLES, PHASES, 3)), np.zeros((1, CYCLES, COORDINATES, PHASES))
        ),
        speeds=np.zeros(CYCLES, dtype=int),
    )


@pytest.mark.parametrize("name", BASELINES)
def test_a_plain_case_is_no_riddle(name, tmp_path):
    found = BASELINES[name](lines(np.random.default_rng(0), 0.5))
    write_answer(found, tmp_path)
    answer = read_answer(tmp_path)
    assert answer.outcome == "named" and answer.named == {"effect_3"}
    assert answer.ranking[0] == "effect_3" and len(answer.ranking) == EFFECTS


def test_the_modification_index_alarms_as_often_as_it_says_under_its_own_assumptions():
    """One case in twenty: it is not the arithmetic that fails on recordings."""
    generator = np.random.default_rng(1)
    alarms = [
        any(passes for _, passes in modification_index(lines(generator, 0.0)).values()) for _ in range(400)
    ]
    assert 0.02 < np.mean(alarms) < 0.09


def test_without_lines_there_is_silence(tmp_path):
    write_silence("not_converged", tmp_path)
    assert json.loads((tmp_path / "gap.json").read_text())["outcome"] == "not_converged"
    assert not read_answer(tmp_path).names
