"""How the coefficients of a muscle path follow the cylinders that it wraps round: the inner level.

After Ao, Fregly et al., each coefficient of the outer level is a cubic polynomial of the six wrap
parameters of a cylinder. Here it is one of what they differ from nominal by, without a constant: nominal
parameters give the nominal coefficients exactly. Several cylinders of one muscle add up.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.polynomial import monomial_exponents, monomials
from wrapjax.geometry.surfaces import WRAP_PARAMETERS

#: Highest total degree: 84 monomials of six parameters, of which the constant is the nominal path's.
DEGREE = 3
_PER_WRAP = len(WRAP_PARAMETERS)
_EXPONENTS = monomial_exponents(_PER_WRAP, DEGREE)[1:]
#: How strongly weights are held to zero, in samples at an end of the box; what foretells best is taken.
RIDGES = (0.0, 1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.3, 1.0, 3.0)
# A sample that alone decides its own value is foretold by nothing.
_LEAST = 1e-6
#: Monomials of one cylinder's changes.
MONOMIALS = len(_EXPONENTS)


class InnerLevel(eqx.Module):
    """Cubic polynomials from cylinders to outer coefficients, all muscles in one shape.

    A muscle with fewer cylinders, or fewer coefficients, than others has zeros there.
    """

    #: m
    weights: Float[Array, "*muscle wrap monomial term"]
    #: Half width of the sampled box, in the parameters' units.
    half_range: Float[Array, "*muscle wrap wrap_parameter"]

    def __call__(self, changes: Float[Array, "muscle mode"]) -> Float[Array, "muscle term"]:
        """Give what coefficients differ from nominal by (m).

        Parameters
        ----------
        changes
            What the parameters of each muscle's cylinders differ from nominal by, in their units, one
            cylinder after the other in the order of its path.
        """
        return jax.vmap(InnerLevel.of_one)(self, changes)

    def slopes(self, changes: Float[Array, "muscle mode"]) -> Float[Array, "muscle mode term"]:
        """Differentiate each muscle's coefficients by its own changes."""

        return jax.vmap(lambda level, own: jax.jacfwd(level.of_one)(own).T)(self, changes)

    def curvature(
        self, changes: Float[Array, "muscle mode"], weights: Float[Array, "muscle term"]
    ) -> Float[Array, "muscle mode mode"]:
        """Differentiate each muscle's coefficients twice, and sum with these weights."""

        def of_one(level, own, weight):
            return jax.hessian(lambda at: weight @ level.of_one(at))(own)

        return jax.vmap(of_one)(self, changes, weights)

    def of_one(self, changes: Float[Array, " mode"]) -> Float[Array, " term"]:
        """Do the same for a level that is of one muscle, without the axis ``muscle``."""
        scaled = changes.reshape(self.half_range.shape) / self.half_range
        return jnp.einsum("wk,wkt->t", monomials(jnp.asarray(_EXPONENTS), scaled), self.weights)


def fit_inner_level(
    changes: Float[np.ndarray, "sample wrap wrap_parameter"],
    half_range: Float[np.ndarray, "wrap wrap_parameter"],
    coefficients: Float[np.ndarray, "sample term"],
    used: Bool[np.ndarray, " sample"],
    metric: Float[np.ndarray, "term term"],
) -> Float[np.ndarray, "wrap monomial term"]:
    """Fit one muscle's inner level by ridge regression.

    Where few placements are physiological, a cubic follows single samples. So of `RIDGES` the one is
    taken by which each sample is best foretold from all others.

    Parameters
    ----------
    changes
        What the parameters of its cylinders differ from nominal by at each sample, all moved at once.
    half_range
        Of the sampled box.
    coefficients
        What outer coefficients differ from the nominal path's by at each sample, m.
    used
        Which samples count.
    metric
        Quadratic form of an error in the coefficients that says how bad it is.

    Returns
    -------
    Array
        Of least norm where there are fewer samples than monomials.
    """
    scaled = (changes / half_range).reshape(-1, _PER_WRAP)
    count, wraps = changes.shape[:2]
    design = np.asarray(monomials(jnp.asarray(_EXPONENTS), jnp.asarray(scaled))).reshape(count, -1)[used]
    left, strengths, right = np.linalg.svd(design, full_matrices=False)
    seen = strengths > strengths.max(initial=0.0) * max(design.shape) * np.finfo(float).eps
    left, strengths, right = left[:, seen], strengths[seen], right[seen]
    along = left.T @ coefficients[used]

    def foretelling_error(ridge: float) -> float:
        kept = strengths**2 / (strengths**2 + ridge)
        own_share = np.sum(left**2 * kept, axis=1, keepdims=True)
        missed = (coefficients[used] - left @ (kept[:, None] * along)) / np.maximum(1.0 - own_share, _LEAST)
        return float(np.einsum("si,ij,sj->", missed, metric, missed))

    ridge = min(RIDGES, key=foretelling_error)
    weights = right.T @ ((strengths / (strengths**2 + ridge))[:, None] * along)
    return weights.reshape(wraps, len(_EXPONENTS), -1)
