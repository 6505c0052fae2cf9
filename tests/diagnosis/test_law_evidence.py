"""Evidence for published laws: that of the law by which moments were made is large, that of others is not."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.subject import CURVES, small_recording_and_context
from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.evidence.law_evidence import law_evidence
from wrapjax.diagnosis.evidence.linearization import linearized_model
from wrapjax.diagnosis.fits.muscle_law import fit_muscle_law
from wrapjax.model.forward import joint_moments
from wrapjax.model.freedom import nga_freedom
from wrapjax.model.variables import free_variables
from wrapjax.muscle.published_laws import PUBLISHED_LAWS, nearest_law

#: Standard deviation of white noise of the moments, N m.
NOISE = 1.0


@pytest.mark.slow
@pytest.mark.parametrize("true", ["nmsm", "thelen"])
def test_the_law_of_the_person_has_more_evidence_than_laws_of_other_force(true):
    recording, context = small_recording_and_context()
    base = context.parameters
    law = jnp.asarray(np.tile(nearest_law(true), (len(context.muscles), 1)))
    exact = np.asarray(joint_moments(CURVES, replace(base, law=law), recording))
    measured = exact + NOISE * np.random.default_rng(1).normal(size=exact.shape)
    freedom = nga_freedom(base)
    problem = Objective(
        curves=CURVES,
        recording=recording,
        measured=jnp.asarray(measured),
        variables=free_variables(base, freedom, context.muscles),
        penalties=(),
        limits=(),
        moment_error=np.array(NOISE),
    )
    fitted = fit_muscle_law(problem, base, freedom, context.muscles)
    linearized = linearized_model(
        fitted.free,
        jnp.asarray(fitted.with_free_law(fitted.variables)),
        recording,
        measured,
        context,
        (),
    )
    calibrated = linearized.calibrated.reshape(len(linearized.calibrated), -1)
    covariance = calibrated.T @ calibrated + NOISE**2 * np.eye(calibrated.shape[1])
    found = law_evidence(fitted, fitted.variables, linearized, covariance)
    assert set(found) == set(PUBLISHED_LAWS)
    # The exponential relation of force to EMG is not compared: other parameters make up for it.
    others = {"nmsm", "thelen", "de_groote"} - {true}
    assert found[true] > 0.0
    assert all(found[true] > found[other] + 30.0 for other in others)
