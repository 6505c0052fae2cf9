"""Defends: squats and running leave walking as it was and obey mechanics; causes act as in walking."""

import dataclasses

import numpy as np
import pytest

from validation.sealed_judge.bank import make, with_other_tasks
from validation.sealed_judge.dynamics import inverse_dynamics
from validation.sealed_judge.effects import EFFECTS
from validation.sealed_judge.leg import frames
from validation.sealed_judge.movements import RUNNING, SQUATS, take
from validation.sealed_judge.person import draw_person
from validation.sealed_judge.session import Session
from wrapjax.diagnosis.inputs.read_movement import read_recorded_movement
from wrapjax.subject.subject import load_subject

SEED = 7


@pytest.fixture(scope="module")
def session():
    return Session(draw_person(SEED, "P01"), SEED)


@pytest.fixture(scope="module")
def squats(session):
    return take(SQUATS, session, [], np.random.default_rng(SEED))[0]


@pytest.fixture(scope="module")
def running(session):
    return take(RUNNING, session, [], np.random.default_rng(SEED))[0]


@pytest.fixture(scope="module")
def walking(tmp_path_factory):
    folder = tmp_path_factory.mktemp("banks") / "walking"
    make(folder, 1, SEED, 1)
    return folder


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


def test_moments_of_the_muscles_balance_running_in_stance(session, running):
    """In swing nothing takes up what muscles of this bandwidth cannot make."""
    rec, person = running.view.rec, session.person
    needed = inverse_dynamics(person.leg, rec.q, rec.pelvis, rec.force, rec.cop, rec.free)
    phase = np.mod(rec.phase, 1.0)
    written = (rec.time >= rec.events[0]) & (rec.time <= rec.events[-1])
    loaded = written & (rec.force[:, 1] > person.mass * 9.80665)
    assert np.sqrt(np.mean((needed - running.moments)[loaded] ** 2, axis=0)).max() < 1.0
    swing = written & (phase > 0.45) & (phase < 0.95)
    assert np.sqrt(np.mean((needed - running.moments)[swing] ** 2, axis=0)).max() < 20.0
    middle = np.abs(phase - 0.18) < 0.02
    ankle = running.moments[middle, 4].mean() / person.mass
    knee = running.moments[middle, 3].mean() * person.leg.knee_sign / person.mass
    assert -2.6 < ankle < -1.4 and -2.2 < knee < -0.9


def test_running_has_flight_and_carries_the_body(session, running):
    rec = running.view.rec
    phase = np.mod(rec.phase, 1.0)
    assert not rec.force[(phase > 0.4) & (phase < 0.99)].any()
    both = rec.force[:, 1] + rec.other_force[:, 1]
    assert (both == 0.0).mean() > 0.15
    cycles = (rec.time >= rec.events[0]) & (rec.time < rec.events[-1])
    assert both[cycles].mean() == pytest.approx(session.person.mass * 9.80665, rel=0.15)
    assert running.drive.min() > 0.0
    assert running.drive.max() < 0.95


@pytest.mark.parametrize("movement", [SQUATS, RUNNING], ids=lambda one: one.name)
@pytest.mark.parametrize("effect", ["passive_joint_moment", "wrap_surface", "contracture"])
def test_the_drive_adapts_to_a_cause(session, effect, movement):
    cause = EFFECTS[effect](EFFECTS[effect].limits[0], np.random.default_rng(1), session.person)
    plain, changed = take(movement, session, [cause], np.random.default_rng(SEED))
    difference = np.sqrt(np.mean((plain.moments - changed.moments) ** 2, axis=0))
    assert difference.max() < {"squats": 3.0, "running": 8.0}[movement.name]
    assert np.abs(plain.drive - changed.drive).max() > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("name", "windows", "miss"), [("squats", 9, 6.0), ("running", 7, 25.0)])
def test_the_folder_has_walking_and_the_movement_with_forces(tmp_path, walking, name, windows, miss):
    """The laboratory's moments are those of inverse dynamics of its files, by another program."""
    moving = tmp_path / "moving"
    with_other_tasks(walking, moving, 1, name)
    for file in (walking / "cases" / "case001" / "trials").rglob("*.*"):
        assert (moving / file.relative_to(walking)).read_bytes() == file.read_bytes()
    subject = load_subject(moving / "cases" / "case001")
    own = np.array(subject.trials.recordings) == name
    assert own.sum() == windows
    assert {subject.trials.tasks[row] for row in np.flatnonzero(own)} == {"movement"}
    recordings = tuple(one for one in subject.recordings if one.name == name)
    leg = dataclasses.replace(subject, trials=subject.trials.select(own), recordings=recordings)
    movement, reason = read_recorded_movement(leg)
    assert movement is not None, reason
    found = movement.mechanics.moments(movement.transmitted_wrenches()).reshape(-1, *movement.time.shape)
    for row, coordinate in enumerate(movement.mechanics.coordinates):
        theirs = leg.trials.moments[:, leg.trials.moment_coordinates.index(coordinate)]
        assert np.sqrt(np.nanmean((found[row] - theirs) ** 2)) < miss
