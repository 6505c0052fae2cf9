"""Muscle law of the person, calibrated together with the parameters of the muscles.

A residual of a model with another muscle law than the person's points along the signatures of the effects.
The baseline fit therefore frees the common parameters of a continuous family of laws
(`wrapjax.muscle.personal_law`) beside everything else, once and over all calibration cycles. Fits to parts of
the cycles, and fits with effects, hold the law that was found; the score test frees it again to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.fits.joint_fit import fit_jointly, joint_problem
from wrapjax.diagnosis.inputs.priors import with_published_priors
from wrapjax.io.store import Store
from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import ModelParameters
from wrapjax.model.variables import free_variables
from wrapjax.muscle.personal_law import LAW_NAMES, given_law


@dataclass(frozen=True)
class MuscleLawFit:
    """Calibration with a free muscle law, and the same calibration with the law that was found held.

    Parameters
    ----------
    free
        Objective whose variables include the parameters of the law.
    held, variables
        Objective with the law held, and its variables where the fit ended.
    curves
        Name of the Hill curves that the family changes.
    """

    free: Objective
    held: Objective
    variables: Float[np.ndarray, " variable"]
    curves: str = "paper"

    @property
    def law(self) -> dict[str, float]:
        """Values of the parameters of the law, by name."""
        law = self.held.initial.law
        assert law is not None
        return dict(zip(LAW_NAMES, np.asarray(law)[0].tolist(), strict=True))

    def with_free_law(self, variables: Float[np.ndarray, " held"]) -> Float[np.ndarray, " free"]:
        """Convert variables of the objective with the law held to those of the one with a free law."""
        return np.asarray(self.free.start(self.held.parameters(jnp.asarray(variables))))


def fit_muscle_law(
    problem: Objective,
    parameters: ModelParameters,
    freedom: Freedom,
    muscles: Sequence[str],
    cache: Store | None = None,
    curves: str = "paper",
) -> MuscleLawFit:
    """Calibrate the muscle law together with the freed parameters of the muscles.

    Priors are the published spread between people (`wrapjax.diagnosis.inputs.priors`).

    Parameters
    ----------
    problem
        Objective of the calibration, with held paths.
    parameters
        Parameters at which the calibration ended.
    freedom
        Freedom of the calibration, with held paths.
    muscles
        Names of the muscles.
    cache
        Earlier fits.
    curves
        Name of the Hill curves of the objective.
    """
    start = replace(parameters, law=jnp.asarray(given_law(len(muscles))))
    prior = with_published_priors(freedom)
    free = replace(problem, variables=free_variables(start, prior, muscles))
    initial = np.asarray(free.start(start))
    fit = fit_jointly(joint_problem(free, Effects(()), initial, np.zeros(0), 0.0), initial, cache=cache)
    found = free.parameters(jnp.asarray(fit.calibrated))
    held = replace(problem, variables=free_variables(found, replace(prior, law=None), muscles))
    return MuscleLawFit(free, held, np.asarray(held.start(found)), curves)
