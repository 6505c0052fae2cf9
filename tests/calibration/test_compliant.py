"""Calibration with compliant tendons: run folder, prediction and joint contact forces."""

import numpy as np
import pytest

from tests.path_sources.round_trip import assert_reproduces_itself
from wrapjax.calibration.calibration import calibrate
from wrapjax.contact_forces.contact_force import contact
from wrapjax.contact_forces.contact_result import MUSCLE_SHARE
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


def test_a_loaded_run_has_compliant_tendons(stretching, run, person):
    assert stretching.status.converged
    read = load_run(run)
    assert read.tendon == "compliant"
    assert_reproduces_itself(run, person)
    modelled = evaluate(read, person).modelled
    np.testing.assert_allclose(modelled, stretching.result.modelled, atol=1e-9)


def test_moments_differ_from_those_of_rigid_tendons(stretching, run, person):
    """With the same parameters; otherwise the other tests would show nothing."""
    text = (run / "settings.json").read_text()
    try:
        (run / "settings.json").write_text(text.replace('"tendon": "compliant"', '"tendon": "rigid"'))
        rigid = evaluate(load_run(run), person).modelled
    finally:
        (run / "settings.json").write_text(text)
    assert np.abs(rigid - stretching.result.modelled).max() > 0.1


def test_contact_forces_are_those_of_compliant_tendons(stretching, run):
    result = contact(run).result
    assert result.kind == MUSCLE_SHARE
    force = np.asarray(stretching.result.states.fiber.tendon_force)
    # Both muscles compress the knee with their full force, at a small angle to each other.
    pressed = result.runs[0].magnitude[:, list(result.joints).index("knee")]
    assert (pressed <= force.sum(axis=0) + 1e-6).all() and (pressed >= 0.9 * force.sum(axis=0)).all()


def test_a_diagnosis_of_it_is_refused(stretching):
    with pytest.raises(InputError, match="the calibration of synthetic: has compliant tendons"):
        diagnose_calibrated(stretching)
