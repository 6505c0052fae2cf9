"""Evaluation of several problems of one shape in one program by `jax.vmap`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.objective import Objective


def batched(
    function: Callable[[Objective, Array], Any], problems: Sequence[Objective]
) -> Callable[[Float[Array, "subject variable"]], Any]:
    """Compile a function of problem and variables for several subjects at once.

    Arrays that are equal in all problems, such as the layout of the variables, are not batched: a gather by
    an index that differs between subjects compiles to a slower program.

    Parameters
    ----------
    function
        Function of one problem and its variables.
    problems
        Problems whose arrays have equal shapes.

    Returns
    -------
    Callable
        Function of the variables of all subjects; the leaves of its result lead with ``subject``.
    """
    leaves = [jax.tree.leaves(eqx.filter(problem, eqx.is_array)) for problem in problems]
    structure = jax.tree.structure(eqx.filter(problems[0], eqx.is_array))
    rest = eqx.filter(problems[0], eqx.is_array, inverse=True)
    stacked, axes = [], []
    for first, *others in zip(*leaves, strict=True):
        equal = all(np.array_equal(first, other) for other in others)
        stacked.append(first if equal else jnp.stack([first, *others]))
        axes.append(None if equal else 0)

    @jax.jit
    def run(stacked: list[Array], variables: Float[Array, "subject variable"]) -> Any:
        def single(arrays: list[Array], point: Float[Array, " variable"]) -> Any:
            return function(eqx.combine(jax.tree.unflatten(structure, arrays), rest), point)

        return jax.vmap(single, in_axes=(axes, 0))(stacked, variables)

    return lambda variables: run(stacked, variables)
