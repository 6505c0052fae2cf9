"""Evidence for published muscle laws against the law of the person, which is free within a family."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Float
from scipy.stats import multivariate_normal

from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.fits.muscle_law import MuscleLawFit
from wrapjax.diagnosis.null_hypotheses.error_sources import Matrix
from wrapjax.model.variables import LAW_OWNER
from wrapjax.muscle.personal_law import LAW_NAMES
from wrapjax.muscle.published_laws import PUBLISHED_LAWS, nearest_law


def law_evidence(
    law: MuscleLawFit,
    variables: Float[np.ndarray, " variable"],
    linearized: LinearizedModel,
    covariance: Matrix,
) -> dict[str, float]:
    """Compute the log Bayes factor of each published law against the continuous family, nats.

    It is the ratio of the posterior density of the family's parameters to their prior density, at the point
    of the published law (Dickey 1971, doi:10.1214/aoms/1177693507), with all other parameters free. The model
    is linearised about the law that was found, so that values for laws far from it are approximate. No effect
    of the catalogue is assumed: one that is present is partly absorbed by the law, and distorts its evidence.

    Parameters
    ----------
    law
        Fit of the muscle law.
    variables
        Calibrated variables, with the law held, about which the model is linearised.
    linearized
        Linearised model.
    covariance
        Null covariance of its residual; see `wrapjax.diagnosis.null_hypotheses.null_covariance`.

    Returns
    -------
    dict
        Evidence by the name of the law; positive where the recording supports it.
    """
    free = law.free.variables
    places = [free.labels.index(f"{LAW_OWNER}.{name}") for name in LAW_NAMES]
    prior_mean = (law.with_free_law(variables) - linearized.from_prior_mean)[places]
    prior = linearized.prior_root @ linearized.prior_root.T
    prior_of_law = prior[np.ix_(places, places)]
    slopes = linearized.slopes.reshape(len(linearized.slopes), -1)
    shared = prior[places] @ slopes
    factor = scipy.linalg.cho_factor(covariance, lower=True, check_finite=False)
    gain = scipy.linalg.cho_solve(factor, shared.T, check_finite=False).T
    posterior_mean = prior_mean + gain @ linearized.residual.reshape(-1)
    posterior = prior_of_law - gain @ shared.T
    found = law.held.parameters(jnp.asarray(variables))

    def log_ratio(name: str) -> float:
        published = np.tile(nearest_law(name, law.curves), (len(free.index), 1))
        point = np.asarray(free.pack(replace(found, law=jnp.asarray(published))))[places]
        by_data = multivariate_normal(posterior_mean, posterior, allow_singular=True)
        by_prior = multivariate_normal(prior_mean, prior_of_law, allow_singular=True)
        return float(by_data.logpdf(point) - by_prior.logpdf(point))

    return {name: log_ratio(name) for name in PUBLISHED_LAWS}
