"""Defends: trials of a dynamometer leave walking as it was; people are at rest or in effort as planned."""

import dataclasses
import json

import numpy as np
import pytest

from validation.sealed_judge import gait
from validation.sealed_judge.bank import make, with_other_tasks
from validation.sealed_judge.effect import View
from validation.sealed_judge.effects import EFFECTS
from validation.sealed_judge.leg import geometry
from validation.sealed_judge.other_tasks import PLANS, RESISTANCE
from validation.sealed_judge.person import draw_person
from wrapjax.io.storage import read_storage
from wrapjax.subject.subject import load_subject


@pytest.fixture(scope="module")
def banks(tmp_path_factory):
    walking, tasks = (tmp_path_factory.mktemp("banks") / name for name in ("walking", "tasks"))
    make(walking, 1, 7, 1)
    with_other_tasks(walking, tasks, 1, "dynamometer")
    return walking, tasks


@pytest.mark.slow
def test_walking_is_the_same(banks):
    walking, tasks = banks
    for file in (walking / "cases" / "case001" / "trials").rglob("*.*"):
        assert (tasks / file.relative_to(walking)).read_bytes() == file.read_bytes()
    manifests = [json.loads((bank / "manifest.json").read_text())["sha256"] for bank in banks]
    assert manifests[0]["case001"]["truth"] == manifests[1]["case001"]["truth"]


@pytest.mark.slow
def test_each_trial_is_read_with_its_task(banks):
    subject = load_subject(banks[1] / "cases" / "case001")
    tasks = {one.name: one.task for one in subject.recordings}
    for plan in PLANS:
        assert tasks[plan.name] == plan.task
        moments = subject.trials.moments[[name == plan.name for name in subject.trials.recordings]]
        assert np.isfinite(moments).any(axis=(0, 2)).sum() == 1


@pytest.mark.slow
def test_a_rotation_ends_where_the_joint_resists_and_a_ramp_pulls_in_its_direction(banks):
    case = banks[1] / "cases" / "case001"
    flexion = json.loads((banks[1] / "truth" / "case001.json").read_text())["side"]
    for plan in PLANS:
        table = read_storage(case / "trials" / plan.name / "moments.sto")
        (name,) = table.columns
        assert name == f"{plan.joint}_{flexion}_moment"
        # The noise of the device and the motion add to the resistance at which the rotation ends.
        if plan.sign == 0:
            assert np.abs(table.values).max() < 1.2 * RESISTANCE
        elif plan.joint != "knee_angle":
            assert plan.sign * table.values[len(table.values) // 2] > 5.0


@pytest.mark.parametrize("effect", ["passive_joint_moment", "biarticular_spring", "contracture"])
def test_a_structure_has_in_a_rotation_the_law_of_walking(effect):
    """Part of a walk, whose range of angles is another, gets the same moments and forces as in the whole."""
    rng = np.random.default_rng(3)
    person = draw_person(5, "P01")
    structure = EFFECTS[effect](0.1, rng, person)
    rec = gait.record(rng, person.leg, person.mass, person.speeds[0], 3, person.style)
    whole = View(person, rec, *geometry(person.leg, rec.q), person.muscles, person.speeds)
    half = slice(0, len(rec.time) // 5)
    part = View(
        person, dataclasses.replace(rec, q=rec.q[half]), whole.lmt[half], whole.arms[half], person.muscles,
        person.speeds, whole,
    )  # fmt: skip
    for of_whole, of_part in zip(effects_of(structure, whole), effects_of(structure, part), strict=True):
        assert np.abs(of_whole).max() > 0.0
        np.testing.assert_array_equal(of_part, of_whole[half])


def effects_of(structure, view):
    """Compute the moments or the muscle forces of a passive structure."""
    force = np.zeros_like(view.lmt)
    if structure.id == "contracture":
        yield structure.force(force, force, view.muscles, view)
    else:
        yield structure.moment(force, view)
