"""Parameter tree: all quantities of the muscles that a calibration can adjust, with units."""

from __future__ import annotations

from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.muscle.published_laws import GIVEN_LAW, PUBLISHED_LAWS, nearest_law


class ModelParameters(eqx.Module):
    """Parameters of all muscles in SI units; the leading axis of every leaf is ``muscle``.

    Units and meanings of the scalar parameters are in `QUANTITIES`.
    """

    electromechanical_delay: Float[Array, "*muscle"]
    activation_time_constant: Float[Array, "*muscle"]
    activation_nonlinearity: Float[Array, "*muscle"]
    emg_scale: Float[Array, "*muscle"]
    optimal_fiber_length: Float[Array, "*muscle"]
    tendon_slack_length: Float[Array, "*muscle"]
    max_isometric_force: Float[Array, "*muscle"]
    pennation_angle: Float[Array, "*muscle"]
    max_fiber_velocity: Float[Array, "*muscle"]
    #: Coefficient of each mode of the path (`AdjustablePath`) or change of each wrap parameter; the number of
    #: modes is that of the paths, often zero.
    path_changes: Float[Array, "*muscle mode"]
    #: Weights of the synergy commands in the EMG of muscles without a channel, dimensionless; zero for other
    #: muscles. None where every muscle has a channel.
    synergy_weights: Float[Array, "*muscle command"] | None = None
    #: Parameters of the person's muscle law (`personal_law.LAW_PARAMETERS`), dimensionless, the same in all
    #: muscles. None for the given curves and the dynamics of He et al. 1991.
    law: Float[Array, "*muscle law_parameter"] | None = None


@dataclass(frozen=True)
class Quantity:
    """Unit of a parameter and its meaning in words, for reports."""

    unit: str
    meaning: str


#: Unit and meaning of the scalar parameters: leaves of `ModelParameters` with one number per muscle.
QUANTITIES: dict[str, Quantity] = {
    "electromechanical_delay": Quantity("s", "time from EMG to muscle excitation"),
    "activation_time_constant": Quantity(
        "s", "time constant of activation; deactivation takes 4 times as long"
    ),
    "activation_nonlinearity": Quantity("1", "0: force linear in neural activation"),
    "emg_scale": Quantity("1", "excitation at the channel's largest recorded EMG"),
    "optimal_fiber_length": Quantity("m", "fiber length of largest active force"),
    "tendon_slack_length": Quantity("m", "length of the unloaded tendon"),
    "max_isometric_force": Quantity("N", "active force at optimal fiber length, full activation, at rest"),
    "pennation_angle": Quantity("rad", "angle between fibers and tendon at optimal fiber length"),
    "max_fiber_velocity": Quantity("1/s", "fastest shortening in optimal fiber lengths a second"),
}

#: Generic maximum fiber velocity, optimal fiber lengths per second (Zajac 1989, Crit Rev Biomed Eng 17:359).
MAX_FIBER_VELOCITY = 10.0


def initial_parameters(
    max_isometric_force: Float[Array | np.ndarray, " muscle"],
    optimal_fiber_length: Float[Array | np.ndarray, " muscle"],
    tendon_slack_length: Float[Array | np.ndarray, " muscle"],
    pennation_angle: Float[Array | np.ndarray, " muscle"],
    *,
    path_modes: int = 0,
    commands: int | None = None,
) -> ModelParameters:
    """Build the initial parameter tree of a calibration.

    Electromechanical delay 50 ms, activation time constant 15 ms, nonlinearity 0.05 and EMG scale 0.5 are
    the initial values of the NMSM Pipeline; the other values are those of the model.

    Parameters
    ----------
    max_isometric_force
        Maximum isometric forces, N.
    optimal_fiber_length, tendon_slack_length
        Lengths, m.
    pennation_angle
        Pennation angles at optimal fiber length, rad.
    path_modes
        Number of modes of the paths; their initial coefficients are zero.
    commands
        Number of synergy commands, with initial weights of zero; None where every muscle has an EMG channel.
    """
    ones = jnp.ones(jnp.shape(max_isometric_force))
    return ModelParameters(
        electromechanical_delay=0.05 * ones,
        activation_time_constant=0.015 * ones,
        activation_nonlinearity=0.05 * ones,
        emg_scale=0.5 * ones,
        optimal_fiber_length=jnp.asarray(optimal_fiber_length),
        tendon_slack_length=jnp.asarray(tendon_slack_length),
        max_isometric_force=jnp.asarray(max_isometric_force),
        pennation_angle=jnp.asarray(pennation_angle),
        max_fiber_velocity=MAX_FIBER_VELOCITY * ones,
        path_changes=jnp.zeros((*ones.shape, path_modes)),
        synergy_weights=None if commands is None else jnp.zeros((*ones.shape, commands)),
    )


def with_path_modes(parameters: ModelParameters, count: int) -> ModelParameters:
    """Pad a parameter tree with zeros to at least ``count`` path modes, as paths that are held have none."""
    changes = parameters.path_changes
    missing = max(count - changes.shape[-1], 0)
    padded = jnp.pad(changes, [(0, 0)] * (changes.ndim - 1) + [(0, missing)])
    return eqx.tree_at(lambda tree: tree.path_changes, parameters, padded)


def with_muscle_law(parameters: ModelParameters, law: str, curves: str) -> ModelParameters:
    """Set the muscle law of all muscles to a published one.

    Parameters
    ----------
    parameters
        Parameters with the given law.
    law
        Name of the law; see `wrapjax.muscle.published_laws`.
    curves
        Name of the Hill curves.

    Raises
    ------
    ValueError
        If the law is unknown.
    """
    if law not in PUBLISHED_LAWS:
        raise ValueError(f"unknown muscle law '{law}': expected one of {', '.join(PUBLISHED_LAWS)}")
    if law == GIVEN_LAW:
        return parameters
    muscles = len(parameters.emg_scale)
    return replace(parameters, law=jnp.asarray(np.tile(nearest_law(law, curves), (muscles, 1))))
