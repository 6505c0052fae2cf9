"""Defends: a learned ranking is judged in worlds and simulators that it was not fitted on."""

import json

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import COORDINATES, CYCLES, PHASES, lines
from validation.blind.library import Library
from validation.diagnosis.learned_ranking import (
    Example,
    LearnedRanking,
    labelled,
    learned_elsewhere,
    main,
    row,
)
from validation.diagnosis.linearizations import save

EFFECTS = ("slow_fibers", "emg_drift")


def shape(seed):
    return np.random.default_rng(seed).normal(size=(CYCLES, PHASES, COORDINATES))


def library(reach=20.0):
    columns = np.stack([shape(2).ravel(), shape(3).ravel()], axis=1)
    return Library(tuple((name, ()) for name in EFFECTS), columns, np.full((3, 2), reach))


@pytest.fixture(scope="module")
def null_case():
    return lines(0.0 * shape(0), dict(zip(EFFECTS, (shape(2), shape(3)), strict=True)))


def example(world, cause, confused, seed=0):
    """The cause has little evidence where another effect has much, as if their forms were exchanged."""
    generator = np.random.default_rng(seed)
    other = next(name for name in EFFECTS if name != cause)
    evidence = {cause: 0.1, other: 6.0} if confused else {cause: 6.0, other: 0.1}
    noise = generator.normal(scale=0.3, size=2)
    return Example(
        world,
        cause,
        8.0,
        {name: evidence[name] + shift for name, shift in zip(EFFECTS, noise, strict=True)},
        dict.fromkeys(EFFECTS, 3.0),
    )


def test_every_effect_is_added_and_scored(null_case):
    found = labelled("world", null_case, library(), np.random.default_rng(0))
    assert [one.cause for one in found] == sorted(EFFECTS)
    assert all(2.0 <= one.d_star <= 15.0 and set(one.evidence) == set(EFFECTS) for one in found)
    # The catalogue has the simulator's forms here.
    assert all(one.ranked[0] == one.cause for one in found)


def test_signals_that_cannot_be_detected_are_left_out(null_case):
    assert labelled("world", null_case, library(reach=1.0), np.random.default_rng(0)) == []


def test_a_confusion_is_learned_from_other_worlds_alone():
    """In two worlds evidence is for the wrong effect, in the third one for the right one."""
    wrong = [example(world, cause, True, seed) for world in "ab" for cause in EFFECTS for seed in range(9)]
    right = [example("c", cause, False) for cause in EFFECTS]
    ranked = learned_elsewhere([*wrong, *right])
    by_world = {
        world: [order[0] == one.cause for one, order in ranked if one.world == world] for world in "abc"
    }
    assert all(by_world["a"]) and all(by_world["b"]) and not any(by_world["c"])
    assert LearnedRanking(wrong).ranked(wrong[0])[0] == wrong[0].cause


def test_rows_count_by_size():
    ranked = [(example("a", EFFECTS[0], False), [EFFECTS[0]]), (example("a", EFFECTS[0], False), [])]
    assert row("title", ranked) == "| title | 0 of 0 | 0 of 0 | 1 of 2 | 1 of 2 |"


def test_command_judges_worlds_that_were_left_out(null_case, tmp_path, capsys):
    (tmp_path / "truth").mkdir()
    for name, world in (("a", "thelen"), ("b", "spline")):
        truth = {"bank": "worlds", "tier": "none", "person": "worlds_00", "world": world}
        (tmp_path / "truth" / f"{name}.json").write_text(json.dumps(truth))
        save(null_case, tmp_path / "lines" / f"{name}.npz")
    (tmp_path / "library").mkdir()
    library().save(tmp_path / "library" / "00.npz")
    arguments = ["--bank", str(tmp_path), "--lines", str(tmp_path / "lines")]
    assert main(arguments) == 0
    table = capsys.readouterr().out.splitlines()
    assert [line.split("|")[1].strip() for line in table[2:]] == [
        "evidence, worlds",
        "regression fitted on the other worlds",
    ]
    (tmp_path / "lines" / "b.npz").unlink()
    assert main(arguments) == 2 and "two worlds at least" in capsys.readouterr().err
    assert main([*arguments, "--judge", str(tmp_path / "none"), str(tmp_path)]) == 2
    assert "no bank" in capsys.readouterr().err
