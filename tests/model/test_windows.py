"""Windows of an interval join without seams, and gait cycles beside them are activated as alone."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from tests.subject.synthetic import write_subject
from tests.subject.task_folders import add_trial, write_mixed_subject
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.model.forward import muscle_states
from wrapjax.model.parameters import with_muscle_law
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.path_sources.model_inputs import model_parameters, recording
from wrapjax.subject.subject import load_subject

#: Slowest activation and longest delay that a calibration may reach, s.
SLOWEST, LONGEST = 0.035, 0.125


def computed_moments(subject, law=None):
    """Compute the moments of straight paths with the slowest activation dynamics."""
    trials, (hip, knee) = subject.trials, np.moveaxis(subject.trials.angles, 1, 0)
    length = np.array([0.42 - 0.05 * hip, 0.4 + 0.05 * knee])
    arm = np.broadcast_to(np.array([0.05, -0.05])[:, None, None, None], (2, len(trials), 2, length.shape[-1]))
    path = PathState(jnp.asarray(length), jnp.zeros(length.shape), jnp.asarray(arm))
    parameters = model_parameters(subject)
    slow = replace(
        parameters,
        activation_time_constant=jnp.full(2, SLOWEST),
        electromechanical_delay=jnp.full(2, LONGEST),
    )
    slow = slow if law is None else with_muscle_law(slow, law, "paper")
    states = eqx.filter_jit(muscle_states)(
        HILL_CURVES["paper"], slow, recording(subject, trials, fixed_path(path))
    )
    return np.asarray(states.moment.sum(axis=0))


@pytest.mark.parametrize("law", [None, "thelen"])
def test_a_border_moved_by_half_a_window_changes_no_moment(tmp_path, law):
    found = {}
    for name, interval in (("early", "[2.5, 5.5]"), ("late", "[3.0, 5.0]")):
        settings = f'task = "movement"\ninterval = {interval}'
        folder = add_trial(write_subject(tmp_path / name), "squat", settings)
        subject = load_subject(folder)
        trials = subject.trials
        moments = computed_moments(subject, law)
        keep = trials.counted & ~trials.is_gait[:, None]
        found[name] = {
            round(time, 6): moment
            for time, moment in zip(trials.time[keep], np.moveaxis(moments, 1, 2)[keep], strict=True)
        }
    common = sorted(found["late"])
    assert len(common) == 201 and set(common) <= set(found["early"])
    early, late = (np.array([found[name][time] for time in common]) for name in ("early", "late"))
    assert np.abs(early - late).max() < 1e-6 * np.abs(late).max()


@pytest.mark.parametrize("law", [None, "thelen"])
def test_gait_beside_other_tasks_has_the_moments_of_gait_alone(tmp_path, law):
    alone = load_subject(write_subject(tmp_path / "alone"))
    mixed = load_subject(write_mixed_subject(tmp_path / "mixed"))
    gait = computed_moments(mixed, law)[mixed.trials.is_gait]
    np.testing.assert_allclose(gait, computed_moments(alone, law), rtol=1e-9, atol=1e-9)
