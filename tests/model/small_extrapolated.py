"""Small synthetic model with muscles that synergy commands drive."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from tests.model.small import MUSCLES, PADDING, small_objective, small_parameters
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.penalties import pipeline_penalties
from wrapjax.model.forward import muscle_states
from wrapjax.model.freedom import nga_freedom, with_synergies
from wrapjax.model.variables import free_variables
from wrapjax.muscle.excitation import CommandSplines, fit_emg_spline

COMMANDS = 3


def small_extrapolated_objective(excitations: dict[str, tuple[str, ...]]) -> Objective:
    """Build an objective in which two commands and a constant drive the muscles of the excitations."""
    plain = small_objective()
    emg = plain.recording.emg
    knots = emg.coefficients.shape[-1] + 1
    time = np.array([[0.010], [0.012]]) * np.arange(-PADDING, knots - PADDING)
    waves = [0.6 * np.sin(30 * time), 0.4 * np.cos(17 * time), np.ones_like(time)]
    commands = fit_emg_spline(time, np.stack(waves, axis=1)).coefficients
    driven = [name for members in excitations.values() for name in members]
    share = jnp.array([[float(name in driven)] for name in MUSCLES])
    emg = dataclasses.replace(
        emg,
        coefficients=emg.coefficients * (1.0 - share[:, :, None, None]),
        commands=CommandSplines(
            jnp.repeat(jnp.moveaxis(commands, 0, 1)[None], len(MUSCLES), axis=0), jnp.tile(share, (1, 2))
        ),
    )
    recording = dataclasses.replace(plain.recording, emg=emg)
    base = eqx.tree_at(
        lambda tree: tree.synergy_weights,
        small_parameters(),
        jnp.zeros((len(MUSCLES), COMMANDS)),
        is_leaf=lambda leaf: leaf is None,
    )
    number = {name: place for place, members in enumerate(excitations.values()) for name in members}
    places = np.array([number.get(name, -1) for name in MUSCLES])
    freedom = with_synergies(nga_freedom(base), tuple(excitations), places, COMMANDS)
    states = muscle_states(plain.curves, base, recording)
    rows = [MUSCLES.index(name) for name in driven]
    return dataclasses.replace(
        plain,
        recording=recording,
        variables=free_variables(base, freedom, MUSCLES),
        penalties=pipeline_penalties(states, [[0, 1]], [[0, 1, 2]], rows),
    )
