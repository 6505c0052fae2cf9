"""Defends: squats leave walking as it was, and obey mechanics; causes act in them as in walking."""

import dataclasses

import numpy as np
import pytest

from validation.sealed_judge.bank import make, with_other_tasks
from validation.sealed_judge.dynamics import inverse_dynamics
from validation.sealed_judge.effects import EFFECTS
from validation.sealed_judge.leg import frames
from validation.sealed_judge.person import draw_person
from validation.sealed_judge.session import Session
from validation.sealed_judge.squats import take
from wrapjax.diagnosis.recorded_inputs.read_movement import read_recorded_movement
from wrapjax.subject.subject import load_subject

SEED = 7


@pytest.fixture(scope="module")
def session():
    return Session(draw_person(SEED, "P01"), SEED)


@pytest.fixture(scope="module")
def squats(session):
    return take(session, [], np.random.default_rng(SEED))[0]


def test_moments_of_the_muscles_balance_the_squat(session, squats):
    rec, leg = squats.view.rec, session.person.leg
    needed = inverse_dynamics(leg, rec.q, rec.pelvis, rec.force, rec.cop, rec.free)
    assert np.sqrt(np.mean((needed - squats.moments) ** 2, axis=0)).max() < 0.1
    lowest = np.argmin(rec.pelvis[:, 4])
    hip, knee = squats.moments[lowest, 0], squats.moments[lowest, 3] * leg.knee_sign
    assert hip < -15.0 and knee < -10.0
    assert 0.45 < rec.force[:, 1].mean() / (session.person.mass * 9.80665) < 0.55


def test_the_foot_stays_flat_where_it_is(session, squats):
    rec = squats.view.rec
    rot, org = frames(session.person.leg, rec.q, rec.pelvis)
    assert np.abs(rot[:, 4, 1, 0]).max() < np.radians(0.1)
    assert np.ptp(org[:, 4], axis=0).max() < 1e-9


def test_drives_are_plausible(squats):
    assert squats.drive.min() > 0.0
    assert squats.drive.max() < 0.8


@pytest.mark.parametrize("effect", ["passive_joint_moment", "wrap_surface", "contracture"])
def test_the_drive_adapts_to_a_cause(session, effect):
    cause = EFFECTS[effect](EFFECTS[effect].limits[0], np.random.default_rng(1), session.person)
    plain, changed = take(session, [cause], np.random.default_rng(SEED))
    difference = np.sqrt(np.mean((plain.moments - changed.moments) ** 2, axis=0))
    assert difference.max() < 3.0
    assert np.abs(plain.drive - changed.drive).max() > 1e-6


def test_the_folder_has_walking_and_squats_with_forces(tmp_path):
    """The laboratory's moments are those of inverse dynamics of its files, by another program."""
    walking, squatting = tmp_path / "walking", tmp_path / "squatting"
    make(walking, 1, SEED, 1)
    with_other_tasks(walking, squatting, 1, "squats")
    for file in (walking / "cases" / "case001" / "trials").rglob("*.*"):
        assert (squatting / file.relative_to(walking)).read_bytes() == file.read_bytes()
    subject = load_subject(squatting / "cases" / "case001")
    own = np.array(subject.trials.recordings) == "squats"
    assert own.sum() == 9 and {subject.trials.tasks[row] for row in np.flatnonzero(own)} == {"movement"}
    recordings = tuple(one for one in subject.recordings if one.name == "squats")
    leg = dataclasses.replace(subject, trials=subject.trials.select(own), recordings=recordings)
    movement, reason = read_recorded_movement(leg)
    assert movement is not None, reason
    found = movement.mechanics.moments(movement.transmitted_wrenches()).reshape(-1, *movement.time.shape)
    for row, name in enumerate(movement.mechanics.coordinates):
        theirs = leg.trials.moments[:, leg.trials.moment_coordinates.index(name)]
        assert np.sqrt(np.nanmean((found[row] - theirs) ** 2)) < 6.0
