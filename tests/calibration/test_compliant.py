"""Tendons that stretch, from end to end: calibrated, kept, read back, predicted by, and what joints bear."""

import numpy as np
import pytest

from tests.path_sources.round_trip import assert_reproduces_itself
from wrapjax.calibration.calibration import calibrate
from wrapjax.contact_forces.contact_force import contact
from wrapjax.contact_forces.result import MUSCLE_SHARE
from wrapjax.diagnosis.diagnosis import diagnose_calibrated
from wrapjax.errors import InputError
from wrapjax.evaluation.evaluation import evaluate
from wrapjax.evaluation.stored_run import load_run
from wrapjax.path_sources.exact import exact_geometry


@pytest.fixture(scope="module")
def stretching(person):
    return calibrate(person, "NGA", exact_geometry(person), tendon="compliant", starts=1)


@pytest.fixture(scope="module")
def run(stretching, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    stretching.save(folder)
    return folder


def test_a_run_read_back_has_tendons_that_stretch(stretching, run, person):
    assert stretching.status.converged
    read = load_run(run)
    assert read.tendon == "compliant"
    assert_reproduces_itself(run, person)
    modelled = evaluate(read, person).modelled
    np.testing.assert_allclose(modelled, stretching.result.modelled, atol=1e-9)


def test_its_moments_are_not_those_of_rigid_tendons(stretching, run, person):
    """Of the same parameters; or nothing would have been in question."""
    text = (run / "settings.json").read_text()
    try:
        (run / "settings.json").write_text(text.replace('"tendon": "compliant"', '"tendon": "rigid"'))
        rigid = evaluate(load_run(run), person).modelled
    finally:
        (run / "settings.json").write_text(text)
    assert np.abs(rigid - stretching.result.modelled).max() > 0.1


def test_joints_bear_the_forces_of_the_tendons(stretching, run):
    result = contact(run).result
    assert result.kind == MUSCLE_SHARE
    force = np.asarray(stretching.result.states.fiber.tendon_force)
    # Both muscles press the knee with their whole force, at a small angle to each other.
    pressed = result.runs[0].magnitude[:, list(result.joints).index("knee")]
    assert (pressed <= force.sum(axis=0) + 1e-6).all() and (pressed >= 0.9 * force.sum(axis=0)).all()


def test_a_diagnosis_does_not_start_from_it(stretching):
    with pytest.raises(InputError, match="the calibration of synthetic: has tendons that stretch"):
        diagnose_calibrated(stretching)
