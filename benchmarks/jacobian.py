"""The dense Jacobian of all residuals, put together from our blocks of muscles, for solvers that want it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.calibration.objective import Objective


def residual_jacobian(
    problem: Objective, variables: Float[Array, " variable"]
) -> Float[Array, "row variable"]:
    """Differentiate `Objective.residuals`, rows in its order, by one small Jacobian a muscle.

    Our own solver never forms it: it needs the products of its columns only.
    """
    of_variables = problem.variables
    _, values, moment_slopes, value_slopes = problem._muscle_slopes(problem._muscle_inputs(variables))
    muscles = jnp.arange(of_variables.index.shape[0])[:, None]
    blocks = []
    for restraint, value, slope in zip(problem._restraints, values, value_slopes, strict=True):
        # How the quantity moves with each variable: by those muscles' entries that it stands at.
        moved = jnp.zeros((of_variables.count + 1, *value.shape)).at[of_variables.index, muscles].add(slope)
        _, push = jax.linearize(restraint.rows, value)
        blocks.append(jax.vmap(push)(moved[:-1]).reshape(of_variables.count, -1).T)
    moments = of_variables.gather(moment_slopes).T
    priors = jnp.diag(jnp.asarray(problem._prior_weight()))
    penalties = len(problem.penalties)
    return jnp.concatenate([moments, *blocks[:penalties], priors, *blocks[penalties:]])
