"""Dense Jacobian of all residuals, for solvers that need it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.calibration.objective import Objective
from wrapjax.model.variables import of_batch


def residual_jacobian(
    problem: Objective, variables: Float[Array, " variable"]
) -> Float[Array, "row variable"]:
    """Differentiate `Objective.residuals` by one small Jacobian for each muscle; rows in its order.

    The solver of wrapjax never forms this matrix: it needs only the products of its columns.
    """
    of_variables = problem.variables
    _, values, moment_slopes, value_slopes = problem._muscle_slopes(problem._muscle_inputs(variables))
    muscles = jnp.arange(of_variables.index.shape[0])[:, None]
    blocks = []
    for penalty, value, slope in zip(problem._all_penalties, values, value_slopes, strict=True):
        # Derivative of the muscles' values with respect to each variable, added over the places it occupies.
        derivative = jnp.zeros((of_variables.count + 1, *value.shape))
        for batch, part in zip(slope.batches, slope.parts, strict=True):
            index = of_batch(batch, of_variables.index)[:, : batch.entries]
            derivative = derivative.at[index, of_batch(batch, muscles)].add(part)
        _, push = jax.linearize(penalty.rows, value)
        blocks.append(jax.vmap(push)(derivative[:-1]).reshape(of_variables.count, -1).T)
    moments = of_variables.gather(moment_slopes).T
    priors = jnp.diag(jnp.asarray(problem._prior_weight()))
    penalties = len(problem.penalties)
    return jnp.concatenate([moments, *blocks[:penalties], priors, *blocks[penalties:]])
