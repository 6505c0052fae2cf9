"""Defends: what was recorded beside gait counts as known, and a diagnosis lists the trials advised for it."""

import dataclasses

import numpy as np
import pytest

from tests.diagnosis.walking_and_tasks import load_with_seven_cycles
from tests.subject.task_folders import write_mixed_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.diagnosis.diagnosis import diagnose_calibrated
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.protocol.inputs import input_of_calibration
from wrapjax.diagnosis.protocol.protocol import ADVISED, advise_trials, protocol
from wrapjax.path_sources.path_fitting import fit
from wrapjax.subject.gait_alone import with_gait_alone

KEPT = {"joint_damping", "emg_offset", "curve_family"}
WITHOUT = sorted(set(CATALOGUE) - KEPT)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Diagnosis of seven cycles of walking, a passive rotation of the knee, and a squat."""
    mixed = load_with_seven_cycles(write_mixed_subject(tmp_path_factory.mktemp("subjects") / "mixed"))
    gait = dataclasses.replace(with_gait_alone(mixed, "this test"), other_leg=None)
    calibration = calibrate(gait, "NGA", fit(mixed), starts=2)
    return diagnose_calibrated(calibration, without=WITHOUT, null_replicates=2, all_tasks=mixed)


@pytest.fixture(scope="module")
def with_tasks(found):
    return input_of_calibration(found.calibration, found.data, found.other_tasks)


@pytest.fixture(scope="module")
def of_gait(found):
    return input_of_calibration(found.calibration, found.data)


@pytest.mark.slow
def test_recorded_windows_have_their_own_trials_and_rows(found, with_tasks):
    others = found.other_tasks
    recorded = with_tasks.recorded
    assert recorded.sum() == len(others.tasks)
    of_windows = with_tasks.trial[recorded & ~with_tasks.gait]
    assert (of_windows < -1).all()
    assert len(np.unique(of_windows)) == len(set(others.recordings) - {"walk"})
    frames = with_tasks.known.shape[-1]
    assert with_tasks.known[recorded].sum() <= np.isfinite(others.measured).sum()
    assert with_tasks.known[with_tasks.trial == -1].sum() == 6 * 2 * frames


@pytest.mark.slow
def test_recorded_tasks_show_effects_before_any_further_trial(with_tasks, of_gait):
    """A joint that was rotated at rest shows its damping, so that another rotation adds less."""
    before, after = (advise_trials("mixed", "", data, None, 0.0) for data in (of_gait, with_tasks))
    place = before.effects.index("joint_damping")
    assert before.effects == after.effects
    assert (after.before.detectability >= before.before.detectability - 1e-9).all()
    assert after.before.detectability[place] > before.before.detectability[place]
    rotation = "passive_knee_angle_two_speeds"
    added = [{trial.id: nats for trial, nats in one.considered}[rotation] for one in (before, after)]
    assert added[1] < added[0]


@pytest.mark.slow
def test_a_diagnosis_lists_the_trials_that_were_advised_for_it(found, tmp_path):
    advised = protocol(found)
    assert "6 recorded gait cycles and" in advised.basis and "other trial" in advised.basis
    assert set(advised.effects) == KEPT - {"curve_family"}
    further = advised.added_to(found)
    advice = further.summary()["advice"]
    assert len(advice) == len(found.result.advice) + ADVISED
    assert [one["minutes"] for one in advice[-ADVISED:]] == [one.trial.minutes for one in advised.advised]
    further.save(tmp_path / "gap")
    page = (tmp_path / "gap" / "report.html").read_text()
    assert advised.advised[0].trial.what[1:] in page
