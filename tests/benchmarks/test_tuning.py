"""How much everybody has of an effect is found, whatever a case itself is known to have."""

import json
import sys

import numpy as np
import pytest

from benchmarks.banks import SEALED
from benchmarks.known_cases import Known
from benchmarks.tuning import everybody, main
from wrapjax.gap.evidence.projection import Candidate, Null, project

ROWS, SHARE = 60, 0.5


@pytest.fixture(scope="module")
def people():
    """Sixty people, each with signatures of their own; a third have much of the third effect."""
    generator = np.random.default_rng(11)
    found = []
    for number in range(60):
        shapes = generator.normal(size=(4, 2, ROWS))
        prior = np.array([0.4, 2.0])
        none = np.zeros(2, bool)
        candidates = (
            Candidate("common", (shapes[0], shapes[1]), prior, none),
            Candidate("absent", (shapes[2],), prior, none),
            Candidate("cause", (shapes[3],), prior, none),
        )
        # Of each shape so much that both together are as large as the share says.
        amounts = SHARE / np.sqrt(2.0) * prior * generator.normal(size=(2, 2))
        residual = np.einsum("va,var->r", amounts, shapes[:2]) + generator.normal(size=ROWS)
        causes = [{"id": "cause"}] if number % 3 == 0 else []
        if causes:
            residual += 2.0 * prior @ shapes[3]
        truth = {"tier": "single" if causes else "none", "causes": causes, "ties": []}
        projections = (project(residual[None], Null(np.eye(ROWS)), candidates),)
        found.append(Known(truth, candidates, projections))
    return found


def test_shares_are_found(people):
    found = everybody(people)
    assert found["common"] == pytest.approx(SHARE, rel=0.15)
    assert found.get("absent", 0.0) < 0.1 and found.get("cause", 0.0) < 0.1


def test_what_a_case_is_known_to_have_is_not_everybodys(people):
    """Were causes not allowed for, everybody would seem to have some of them."""
    unknown = [Known({**one.truth, "causes": []}, one.candidates, one.projections) for one in people]
    assert everybody(unknown)["cause"] > 0.5


def test_evidence_falls_for_what_everybody_has(people):
    case = people[0]
    nothing, common, cause = (
        case.scored(shares).evidence for shares in ({}, {"common": SHARE}, {"cause": 1.0})
    )
    assert max(nothing, key=lambda id: nothing[id]) == "cause"
    assert common["cause"] > 10.0 > cause["cause"] + 5.0


def test_sealed_cases_teach_nothing(tmp_path, capsys, monkeypatch):
    """A test bank's truth is not opened: it is not even there."""
    manifest = json.loads((SEALED / "test_240.json").read_text(encoding="utf-8"))
    (tmp_path / f"{min(manifest['cases'])}.npz").touch()
    assert _run(monkeypatch, tmp_path) == 2
    assert "expected a case of a development bank" in capsys.readouterr().err


def test_without_lines_there_is_nothing_to_tune(tmp_path, capsys, monkeypatch):
    assert _run(monkeypatch, tmp_path) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_lines_without_truth_are_refused(tmp_path, capsys, monkeypatch):
    (tmp_path / "0123.npz").write_bytes(b"no archive")
    assert _run(monkeypatch, tmp_path) == 2
    assert "0123" in capsys.readouterr().err


def _run(monkeypatch, folder):
    command = ["tuning", "--bank", str(folder), "--lines", str(folder)]
    monkeypatch.setattr(sys, "argv", command)
    return main()
