"""Defends: borrowed signatures find what the catalogue's have no shape for, under the same null."""

import json

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import COORDINATES, CYCLES, PHASES, lines
from validation.blind.library import Library
from validation.diagnosis.linearizations import save
from validation.diagnosis.scored_cases import Scored
from validation.diagnosis.simulator_signatures import both, main, usual


def shape(seed):
    return np.random.default_rng(seed).normal(size=(CYCLES, PHASES, COORDINATES))


def library(**signals):
    columns = np.stack([own.ravel() for own in signals.values()], axis=1)
    return Library(tuple((name, ()) for name in signals), columns, np.ones((3, len(signals))))


def truth(tier):
    cause = {"bank": "development", "tier": tier, "person": "development_00", "emg_noise": 0.05, "ties": []}
    return cause | {"causes": [{"id": "known"}], "d_star": 9.0}


@pytest.fixture(scope="module")
def case():
    """A signal that the catalogue takes for another's: its `known` has a shape of its own."""
    return lines(3.0 * shape(2), {"known": shape(4), "other": shape(2) + shape(3)})


def test_the_true_shape_leads_where_the_catalogues_does_not(case):
    ours, theirs = both(truth("single"), case, library(known=shape(2), other=shape(3)))
    assert list(ours.evidence) == list(theirs.evidence) == ["known", "other"]
    assert theirs.ranked[0] == "known" and theirs.evidence["known"] > 50.0
    # By chance, shapes of a few hundred numbers are a little alike.
    assert ours.evidence["known"] < 0.1 * theirs.evidence["known"]
    assert ours.ranked[0] == "other"
    assert ours.structured == theirs.structured


def test_what_everybody_has_is_listed_of_people_with_nothing_amiss_alone():
    nothing = [Scored(truth("none"), {"a": one, "b": 2.0}, 0.0) for one in (1.0, 3.0, 7.0)]
    (told,) = usual([*nothing, Scored(truth("single"), {"a": 99.0, "b": 99.0}, 0.0)])
    assert told.endswith("strongest 3.0 nats in the median; by effect a 3.0, b 2.0")
    assert usual([]) == []


def test_the_command_tells_of_both(case, tmp_path, monkeypatch, capsys):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "a.json").write_text(json.dumps(truth("single")))
    save(case, tmp_path / "lines" / "a.npz")
    (tmp_path / "library").mkdir()
    library(known=shape(2)).save(tmp_path / "library" / "00.npz")
    asked = ["borrowed", "--bank", str(tmp_path), "--lines", str(tmp_path / "lines")]
    monkeypatch.setattr("sys.argv", asked)
    assert main() == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("the catalogue's signatures: first 0 of 1")
    assert second.startswith("the simulator's signatures: first 1 of 1")
    (tmp_path / "library" / "00.npz").unlink()
    assert main() == 2 and "00.npz" in capsys.readouterr().err
