"""Equilibria of compliant tendons by our root finder and by that of optimistix.

``python -m benchmarks.tendon_equilibrium`` prints, for the tendon forces of twenty muscles over four cycles,
their Jacobian and their Hessians by fiber and slack length: the median times after compilation, the times of
the first calls, and the largest relative difference. Both solve the same equations in one run.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from unittest.mock import patch

from benchmarks.machine import pin_threads

MUSCLES, CYCLES, FRAMES = 20, 4, 101
REPETITIONS = 9


def main() -> int:
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    from wrapjax.jax_setup import set_up_jax

    set_up_jax()
    import numpy as np

    ours, theirs = _measured(None), _measured(_optimistix_root)
    print("| | ours, ms | optimistix, ms | ratio | first call: ours, s | optimistix, s | difference |")
    print("|---|---|---|---|---|---|---|")
    for name in ours:
        (first, once, steady), (second, other_once, other) = ours[name], theirs[name]
        difference = np.abs(first - second).max() / np.abs(first).max()
        print(
            f"| {name} | {1e3 * steady:.1f} | {1e3 * other:.1f} | {other / steady:.2f} "
            f"| {once:.1f} | {other_once:.1f} | {difference:.0e} |"
        )
    return 0


def _optimistix_root(function, guess, lowest, highest):
    """Solve by Newton's method of optimistix, told that the equations are independent of one another."""
    import lineax
    import optimistix

    diagonal = lineax.Diagonal()
    return optimistix.root_find(
        lambda force, _: function(force),
        optimistix.Newton(rtol=1e-14, atol=1e-14, linear_solver=diagonal),
        guess,
        options={"lower": lowest, "upper": highest},
        tags=frozenset([lineax.diagonal_tag]),
        adjoint=optimistix.ImplicitAdjoint(linear_solver=diagonal),
        max_steps=60,
        throw=False,
    ).value


def _measured(root: Callable | None) -> dict[str, tuple]:
    """Compute forces and their derivatives, with the times of the first and of later calls, s."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from wrapjax.muscle import compliant_tendon
    from wrapjax.muscle.curves import HILL_CURVES

    generator = np.random.default_rng(0)
    phase = 2 * np.pi * np.linspace(0.0, 1.0, FRAMES)
    shift = generator.uniform(0.0, 2 * np.pi, (3, MUSCLES, CYCLES, 1))
    signals = (
        jnp.asarray(0.30 + 0.25 * np.sin(2 * phase + shift[0])),
        jnp.asarray(0.35 + 0.01 * np.sin(phase + shift[1])),
        jnp.asarray(0.06 * np.cos(phase + shift[1])),
    )
    lengths = jnp.tile(jnp.array([0.06, 0.28]), (MUSCLES, 1))

    def force(lengths, activation, length, velocity):
        return compliant_tendon.compliant_tendon_fiber(
            HILL_CURVES["paper"],
            activation,
            length,
            velocity,
            jnp.full(CYCLES, 0.01),
            jnp.asarray(0.04),
            max_isometric_force=jnp.asarray(2000.0),
            optimal_fiber_length=lengths[0],
            tendon_slack_length=lengths[1],
            pennation_angle=jnp.asarray(0.2),
            max_fiber_velocity=jnp.asarray(10.0),
        ).tendon_force

    functions = {
        "forces": force,
        "Jacobian": jax.jacfwd(force),
        "Hessian": jax.hessian(lambda *arguments: jnp.sum(force(*arguments))),
    }
    results = {}
    with patch.object(compliant_tendon, "increasing_root", root or compliant_tendon.increasing_root):
        for name, function in functions.items():
            compiled = jax.jit(jax.vmap(function))
            result, first = _timed(compiled, lengths, *signals)
            later = [_timed(compiled, lengths, *signals)[1] for _ in range(REPETITIONS)]
            results[name] = np.asarray(result), first, statistics.median(later)
    return results


def _timed(function: Callable, *arguments) -> tuple:
    import jax

    began = time.perf_counter()
    result = jax.block_until_ready(function(*arguments))
    return result, time.perf_counter() - began


if __name__ == "__main__":
    sys.exit(main())
