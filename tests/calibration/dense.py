"""Derivatives of all residuals at once, with no thought of blocks: what ours are held against."""

import equinox as eqx
import jax
import jax.numpy as jnp


@eqx.filter_jit
def dense_derivatives(problem, point):
    """Residuals, their Jacobian, and the Hessian of half their sum of squares."""
    return problem.residuals(point), jax.jacfwd(problem.residuals)(point), jax.hessian(half(problem))(point)


@eqx.filter_jit
def dense_slopes(problem, point):
    """Residuals, and their Jacobian."""
    return problem.residuals(point), jax.jacfwd(problem.residuals)(point)


def half(problem):
    return lambda at: 0.5 * jnp.sum(problem.residuals(at) ** 2)
