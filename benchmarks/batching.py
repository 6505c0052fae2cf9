"""People of one shape in one program: a batch of problems for `vmap`."""

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
    """Compile a function of problem and variables for several people at once.

    What is the same in all of them, as the layout of the variables, stays single: a gather by an index that
    differs from person to person would be another, slower program.

    Parameters
    ----------
    function
        Of one problem and its variables.
    problems
        Of one shape.

    Returns
    -------
    Callable
        From the variables of all people to what the function gives, leaves leading with ``subject``.
    """
    leaves = [jax.tree.leaves(eqx.filter(problem, eqx.is_array)) for problem in problems]
    structure = jax.tree.structure(eqx.filter(problems[0], eqx.is_array))
    rest = eqx.filter(problems[0], eqx.is_array, inverse=True)
    together, axes = [], []
    for first, *others in zip(*leaves, strict=True):
        alike = all(np.array_equal(first, other) for other in others)
        together.append(first if alike else jnp.stack([first, *others]))
        axes.append(None if alike else 0)

    @jax.jit
    def run(together: list[Array], variables: Float[Array, "subject variable"]) -> Any:
        def of_one(own: list[Array], point: Float[Array, " variable"]) -> Any:
            return function(eqx.combine(jax.tree.unflatten(structure, own), rest), point)

        return jax.vmap(of_one, in_axes=(axes, 0))(together, variables)

    return lambda variables: run(together, variables)
