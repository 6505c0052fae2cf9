"""Defends: what a diagnosis is compared with is done as textbooks say, and answers where the scorer looks."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from validation.blind.score.records import read_answer
from validation.diagnosis.ablations import ABLATIONS, ablated
from validation.diagnosis.baselines import BASELINES, modification_index, write_answer, write_silence
from validation.diagnosis.case_answers import write_others
from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null_covariance import MuscleErrors
from wrapjax.diagnosis.projection import Candidate

CYCLES, COORDINATES, PHASES, EFFECTS = 6, 2, 10, 12
ROWS = CYCLES * COORDINATES * PHASES


def lines(generator, effect_size, at_work=3):
    """Independent noise, three calibrated variables, and one effect of this size."""
    slopes = generator.normal(size=(3, ROWS))
    candidates = tuple(
        Candidate(
            f"effect_{number}", (generator.normal(size=(1, ROWS)),), np.ones(1), np.zeros(1, dtype=bool)
        )
        for number in range(EFFECTS)
    )
    residual = generator.normal(size=ROWS) + effect_size * candidates[at_work].variants[0][0]
    left = residual - slopes.T @ np.linalg.lstsq(slopes.T, residual, rcond=None)[0]
    shape = (CYCLES, COORDINATES, PHASES)
    return LinearizedModel(
        residual=residual.reshape(shape),
        fitted=left.reshape(shape),
        slopes=slopes.reshape(3, *shape),
        spread=np.eye(3),
        away=np.zeros(3),
        nuisances=np.zeros((1, *shape)),
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


@pytest.mark.parametrize("name", ABLATIONS)
def test_a_term_that_is_left_out_takes_nothing_else_with_it(name):
    """A plain case stays plain, and only the score test alone sees all terms."""
    gap = lines(np.random.default_rng(0), 0.5)
    found = ablated(ABLATIONS[name], gap, np.ones(COORDINATES), detection_threshold=3.0)
    assert max(found, key=lambda id: found[id][0]) == "effect_3"
    assert {id for id, (_, named) in found.items() if named} == {
        id for id, (evidence, _) in found.items() if evidence > 3.0
    }


def alike(name, generator):
    """Lines of a residual that is noise and one thing, which the term explains, and an effect as well."""
    whole = lines(generator, 0.0)
    shape = whole.residual.shape
    one = 6.0 * generator.normal(size=shape)
    if name == "without_nuisances":
        whole = replace(whole, nuisances=one[None])
    elif name == "without_give":
        whole = replace(whole, slopes=np.stack([one, *whole.slopes[1:]]))
    elif name == "without_repeated":
        one = 3.0 * np.tile(np.sin(2.0 * np.pi * np.arange(PHASES) / PHASES), (CYCLES, COORDINATES, 1))
    else:
        one = np.full(shape, 3.0)
        arms = np.full((1, *shape), 200.0)
        whole = replace(whole, muscle_errors=MuscleErrors(whole.muscle_errors.states, arms))
    effect = Candidate("alike", (one.reshape(1, -1),), np.ones(1), np.zeros(1, dtype=bool))
    residual = generator.normal(size=shape) + one
    return replace(whole, residual=residual, fitted=residual, candidates=(effect,))


@pytest.mark.parametrize(
    "name", [name for name in ABLATIONS if name not in ("score_alone", "without_input_errors")]
)
def test_what_a_term_explains_is_taken_for_an_effect_without_it(name):
    gap, sizes = alike(name, np.random.default_rng(3)), np.full(COORDINATES, 60.0)
    found = {own: ablated(ABLATIONS[own], gap, sizes, 0.0)["alike"][0] for own in ("score_alone", name)}
    assert found[name] > found["score_alone"] + 3.0


def test_everybody_answers_on_the_lines_of_one_diagnosis(tmp_path):
    gap = lines(np.random.default_rng(0), 0.5)
    done = SimpleNamespace(
        result=SimpleNamespace(lines=gap, outcome="named", detection_threshold=3.0),
        case=SimpleNamespace(measured_sizes=np.random.default_rng(1).uniform(0.5, 1.5, COORDINATES)),
    )
    write_others(done, {name: tmp_path / name for name in (*BASELINES, *ABLATIONS)})
    for name in (*BASELINES, *ABLATIONS):
        assert read_answer(tmp_path / name).ranking[0] == "effect_3", name


def test_the_bank_is_scored_with_everybody_beside_it():
    makefile = (Path(__file__).parents[2] / "Makefile").read_text(encoding="utf-8")
    (names,) = re.findall(r"^ANSWERERS := ((?:.*\\\n)*.*)$", makefile, re.MULTILINE)
    assert names.replace("\\\n", " ").split() == ["wrapjax", *BASELINES, *ABLATIONS]


def test_without_lines_there_is_silence(tmp_path):
    write_silence("not_converged", tmp_path)
    assert json.loads((tmp_path / "gap.json").read_text())["outcome"] == "not_converged"
    assert not read_answer(tmp_path).names
