"""Baselines and ablations: their statistics, and their answers for the scorer."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from validation.blind.score.records import read_answer
from validation.diagnosis.ablations import ABLATIONS, score_ablated
from validation.diagnosis.baselines import BASELINES, modification_index, write_answer, write_no_answer
from validation.diagnosis.case_answers import write_other_answers
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.null_hypotheses.error_sources import MuscleErrors

CYCLES, COORDINATES, PHASES, EFFECTS = 6, 2, 10, 12
ROWS = CYCLES * COORDINATES * PHASES


def lines(generator, effect_size, effect=3):
    """Linearize a synthetic case with independent noise, three calibrated variables and one effect."""
    slopes = generator.normal(size=(3, ROWS))
    candidates = tuple(
        Candidate(
            f"effect_{number}", (generator.normal(size=(1, ROWS)),), np.ones(1), np.zeros(1, dtype=bool)
        )
        for number in range(EFFECTS)
    )
    residual = generator.normal(size=ROWS) + effect_size * candidates[effect].variants[0][0]
    left = residual - slopes.T @ np.linalg.lstsq(slopes.T, residual, rcond=None)[0]
    shape = (CYCLES, COORDINATES, PHASES)
    return LinearizedModel(
        residual=residual.reshape(shape),
        fitted_residual=left.reshape(shape),
        slopes=slopes.reshape(3, *shape),
        prior_root=np.eye(3),
        from_prior_mean=np.zeros(3),
        nuisances=np.zeros((1, *shape)),
        candidates=candidates,
        input_errors=(),
        muscle_errors=MuscleErrors(
            np.zeros((1, CYCLES, PHASES, 3)), np.zeros((1, CYCLES, COORDINATES, PHASES))
        ),
        speeds=np.zeros(CYCLES, dtype=int),
    )


@pytest.mark.parametrize("name", BASELINES)
def test_clear_effect_is_named(name, tmp_path):
    found = BASELINES[name](lines(np.random.default_rng(0), 0.5))
    write_answer(found, tmp_path)
    answer = read_answer(tmp_path)
    assert answer.outcome == "named" and answer.named == {"effect_3"}
    assert answer.ranking[0] == "effect_3" and len(answer.ranking) == EFFECTS


def test_modification_index_has_its_nominal_error_rate():
    """Check a family-wise error rate of about 5 % under the assumptions of the test."""
    generator = np.random.default_rng(1)
    alarms = [
        any(passes for _, passes in modification_index(lines(generator, 0.0)).values()) for _ in range(400)
    ]
    assert 0.02 < np.mean(alarms) < 0.09


@pytest.mark.parametrize("name", ABLATIONS)
def test_ablation_ranks_a_clear_effect_first(name):
    """Check that names follow the detection threshold, and that a clear effect remains first."""
    linearized = lines(np.random.default_rng(0), 0.5)
    found = score_ablated(ABLATIONS[name], linearized, np.ones(COORDINATES), detection_threshold=3.0)
    assert max(found, key=lambda id: found[id][0]) == "effect_3"
    assert {id for id, (_, named) in found.items() if named} == {
        id for id, (evidence, _) in found.items() if evidence > 3.0
    }


def case_explained_by(name, generator):
    """Linearize a case whose residual is noise and a signal that both the term and an effect explain."""
    linearized = lines(generator, 0.0)
    shape = linearized.residual.shape
    one = 6.0 * generator.normal(size=shape)
    if name == "without_nuisances":
        linearized = replace(linearized, nuisances=one[None])
    elif name == "without_give":
        linearized = replace(linearized, slopes=np.stack([one, *linearized.slopes[1:]]))
    elif name == "without_repeated":
        one = 3.0 * np.tile(np.sin(2.0 * np.pi * np.arange(PHASES) / PHASES), (CYCLES, COORDINATES, 1))
    else:
        one = np.full(shape, 3.0)
        arms = np.full((1, *shape), 200.0)
        linearized = replace(linearized, muscle_errors=MuscleErrors(linearized.muscle_errors.states, arms))
    effect = Candidate("alike", (one.reshape(1, -1),), np.ones(1), np.zeros(1, dtype=bool))
    residual = generator.normal(size=shape) + one
    return replace(linearized, residual=residual, fitted_residual=residual, candidates=(effect,))


@pytest.mark.parametrize(
    "name", [name for name in ABLATIONS if name not in ("score_alone", "without_input_errors")]
)
def test_signal_explained_by_a_term_becomes_evidence_without_it(name):
    linearized, sizes = case_explained_by(name, np.random.default_rng(3)), np.full(COORDINATES, 60.0)
    found = {
        own: score_ablated(ABLATIONS[own], linearized, sizes, 0.0)["alike"][0]
        for own in ("score_alone", name)
    }
    assert found[name] > found["score_alone"] + 3.0


def test_all_methods_answer_on_one_linearized_model(tmp_path):
    linearized = lines(np.random.default_rng(0), 0.5)
    done = SimpleNamespace(
        result=SimpleNamespace(linearized=linearized, outcome="named", detection_threshold=3.0),
        data=SimpleNamespace(measured_moment_sd=np.random.default_rng(1).uniform(0.5, 1.5, COORDINATES)),
    )
    write_other_answers(done, {name: tmp_path / name for name in (*BASELINES, *ABLATIONS)})
    for name in (*BASELINES, *ABLATIONS):
        assert read_answer(tmp_path / name).ranking[0] == "effect_3", name


def test_makefile_scores_all_methods():
    makefile = (Path(__file__).parents[2] / "Makefile").read_text(encoding="utf-8")
    (names,) = re.findall(r"^ANSWERERS := ((?:.*\\\n)*.*)$", makefile, re.MULTILINE)
    assert names.replace("\\\n", " ").split() == ["wrapjax", *BASELINES, *ABLATIONS]


def test_answer_without_linearized_model_is_empty(tmp_path):
    write_no_answer("not_converged", tmp_path)
    assert json.loads((tmp_path / "gap.json").read_text())["outcome"] == "not_converged"
    assert not read_answer(tmp_path).names
