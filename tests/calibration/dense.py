"""Dense derivatives of all residuals, a reference for the derivatives by blocks."""

import equinox as eqx
import jax
import jax.numpy as jnp


@eqx.filter_jit
def dense_derivatives(problem, point):
    """Compute residuals, their Jacobian, and the Hessian of half their sum of squares."""
    return (
        problem.residuals(point),
        jax.jacfwd(problem.residuals)(point),
        jax.hessian(half_cost(problem))(point),
    )


@eqx.filter_jit
def dense_slopes(problem, point):
    """Compute residuals and their Jacobian."""
    return problem.residuals(point), jax.jacfwd(problem.residuals)(point)


def half_cost(problem):
    return lambda at: 0.5 * jnp.sum(problem.residuals(at) ** 2)
