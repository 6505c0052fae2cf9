"""Calibrations of made-up moments, one a draw, resumable after any of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from wrapjax.calibrate.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibrate.journal import Journal
from wrapjax.calibrate.posterior import Posterior
from wrapjax.calibrate.solution import Status


def refits(
    judged: Posterior,
    solver: AugmentedLagrangian,
    count: int,
    seed: int,
    *,
    journal: Journal | None = None,
    advance: Callable[[int], None] | None = None,
) -> tuple[Float[np.ndarray, "draw variable"], tuple[Status, ...]]:
    """Calibrate again, from the solution, to moments and priors that were made up (`Posterior.made_up`).

    Parameters
    ----------
    judged
        The solution.
    solver
        That found it.
    count, seed
        Of the draws; the first of many are those of few.
    journal
        Keeps what is finished. What it holds already is not done again.
    advance
        Called with the number of finished draws.

    Raises
    ------
    KeyboardInterrupt
        If the user stops it; the journal keeps what was done.
    """
    found, statuses = [], []
    for number in range(count):
        name = f"draw_{number}"
        entry = journal.read(name) if journal else None
        if entry is not None and entry.status is not None:
            variables, status = np.asarray(entry.state.variables), entry.status
        else:
            solution = solver.solve(judged.made_up(number, seed), judged.state)
            variables, status = solution.variables, solution.status
            if status is Status.interrupted:
                raise KeyboardInterrupt
            if journal:
                journal.write(name, solution.state, solution.history, status)
        found.append(variables)
        statuses.append(status)
        if advance:
            advance(number + 1)
    return np.stack(found), tuple(statuses)
