"""Defends: an added signal is found where signatures have its shape, and missed where they have not."""

import json

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import COORDINATES, CYCLES, PHASES, lines
from validation.blind.library import Library
from validation.diagnosis.added_signals import added, main, told
from validation.diagnosis.linearizations import save


def shape(seed):
    return np.random.default_rng(seed).normal(size=(CYCLES, PHASES, COORDINATES))


@pytest.fixture(scope="module")
def nobody():
    """Noise alone, and two effects of different shapes."""
    return lines(0.0 * shape(0), {"known": shape(2), "other": shape(3)})


def library(**signals):
    columns = np.stack([own.ravel() for own in signals.values()], axis=1)
    entries = tuple((name.rstrip("_"), ()) for name in signals)
    return Library(entries, columns, np.ones((3, len(entries))))


def test_a_signal_of_an_effects_shape_puts_it_first_the_more_the_larger(nobody):
    small, large = added(nobody, library(known=7.0 * shape(2)), (5.0, 8.0))
    assert small.leader == large.leader == "known" and small.rank == large.rank == 0
    assert small.captured == pytest.approx(1.0)
    # Half of its square, give or take what noise adds, less what it costs to know its size and sign.
    assert 5.0 < small.evidence < 18.0 and 22.0 < large.evidence < 42.0


def test_a_signal_like_another_effect_puts_that_first(nobody):
    (one,) = added(nobody, library(known=shape(3)), (8.0,))
    assert one.leader == "other" and one.rank == 1 and one.captured < 0.1


def test_what_no_effect_is_the_cause_of_or_nobody_could_see_is_not_asked(nobody):
    assert added(nobody, library(unheard_of=shape(2), known=1e-6 * shape(2)), (5.0,)) == []


def test_each_effect_counts_alike(nobody):
    found = added(nobody, library(known=shape(2), known_=shape(2), other=shape(2)), (8.0,))
    *rows, mean = told(found)[1:]
    assert [row.split()[0] for row in rows] == ["known", "other"]
    assert rows[0].split()[2:4] == ["2", "1.00"] and rows[1].split()[2:4] == ["1", "0.00"]
    assert mean.split()[-2] == "0.50"


def test_people_with_nothing_amiss_are_asked_and_nobody_else(nobody, tmp_path, monkeypatch, capsys):
    for name, tier in (("a", "none"), ("again", "none"), ("b", "single")):
        (tmp_path / "truth").mkdir(exist_ok=True)
        truth = {"bank": "development", "tier": tier, "person": "development_00"}
        (tmp_path / "truth" / f"{name}.json").write_text(json.dumps(truth))
        save(nobody, tmp_path / "lines" / f"{name}.npz")
    (tmp_path / "library").mkdir()
    library(known=shape(2)).save(tmp_path / "library" / "00.npz")
    asked = ["added", "--bank", str(tmp_path), "--lines", str(tmp_path / "lines"), "--sizes", "8"]
    monkeypatch.setattr("sys.argv", asked)
    assert main() == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:4] == ["known", "8.0", "1", "1.00"]
    for name in ("a", "again"):
        (tmp_path / "lines" / f"{name}.npz").unlink()
    assert main() == 2 and "nothing amiss" in capsys.readouterr().err
