"""Objective that determines fiber and slack lengths from passive moments and operating ranges in walking.

The terms and their allowable errors are those of the NMSM Pipeline's length initialisation, after Meyer et
al. 2017 (doi:10.1371/journal.pone.0179698), with two differences: the dissimilarity of a group is the mean
square of differences from its mean, where the Pipeline takes the largest, which is not differentiable; and
maximum isometric forces are not adjusted.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.calibration.solvers.interface import AbstractLeastSquares, Linearization
from wrapjax.model.alteration import fiber_parameters
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import AbstractCurves
from wrapjax.muscle.hill import rigid_tendon_fiber

#: Bounds of the ratios of lengths to the model's, and of the largest normalised fiber length of a group.
LENGTH_RATIO_BOUNDS = (0.5, 2.0)
LONGEST_FIBER_BOUNDS = (1.0, 1.2)
#: Normalised fiber length below which shortest lengths in walking are penalised.
SHORTEST_FIBER = 0.6


class LengthErrors(eqx.Module):
    """Allowable error of each term; the weight of a term is one over its square."""

    #: Passive joint moment, N m.
    passive_moment: float = 2.0
    #: Difference from 1 of the ratio of the optimal fiber length to the model's.
    fiber_ratio: float = 0.3
    #: Difference from 1 of the ratio of the tendon slack length to the model's.
    slack_ratio: float = 1.0
    #: Difference below `SHORTEST_FIBER` of the shortest normalised fiber length in walking.
    shortest: float = 0.3
    #: Difference of the longest normalised fiber length in walking from the variable of the muscle's group.
    longest: float = 0.03
    #: Difference of that variable from 1.
    group_longest: float = 0.1
    #: Difference of the mean normalised fiber length from the mean of the muscle's group.
    likeness: float = 0.1


class InitialLengthObjective(AbstractLeastSquares):
    """Least-squares objective of passive moments and operating ranges of fibers.

    Variables are the ratios of optimal fiber lengths to the model's, those of tendon slack lengths, and the
    longest normalised fiber length of each group; a muscle in no group is a group of one.
    """

    curves: AbstractCurves
    #: Initial parameters of all muscles.
    parameters: ModelParameters
    #: Muscle-tendon lengths in walking, m.
    walking: Float[Array, "muscle frame"]
    #: Muscle-tendon lengths in the samples of passive trials, m.
    length: Float[Array, "muscle sample"]
    #: Moment arms in these samples, m.
    moment_arm: Float[Array, "muscle coordinate sample"]
    #: Passive joint moments in these samples, N m.
    moment: Float[Array, "coordinate sample"]
    #: Whether each of these moments was recorded.
    recorded: Bool[Array | np.ndarray, "coordinate sample"]
    #: Groups of muscles with similar normalised fiber lengths, as indices.
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    errors: LengthErrors = eqx.field(default_factory=LengthErrors)

    @property
    def muscles(self) -> int:
        """Number of muscles."""
        return self.walking.shape[0]

    @property
    def lower(self) -> Float[np.ndarray, " variable"]:
        """Lower bounds."""
        return np.append(
            np.full(2 * self.muscles, LENGTH_RATIO_BOUNDS[0]),
            np.full(len(self.groups), LONGEST_FIBER_BOUNDS[0]),
        )

    @property
    def upper(self) -> Float[np.ndarray, " variable"]:
        """Upper bounds."""
        return np.append(
            np.full(2 * self.muscles, LENGTH_RATIO_BOUNDS[1]),
            np.full(len(self.groups), LONGEST_FIBER_BOUNDS[1]),
        )

    def start(self) -> Float[Array, " variable"]:
        """Return the variables at the initial lengths."""
        return jnp.ones(2 * self.muscles + len(self.groups))

    def lengths(self, variables: Float[Array, " variable"]) -> ModelParameters:
        """Return the parameters with lengths scaled by the ratios among the variables."""
        ratios = variables[: 2 * self.muscles].reshape(2, -1)
        old = self.parameters
        return eqx.tree_at(
            lambda tree: (tree.optimal_fiber_length, tree.tendon_slack_length),
            old,
            (ratios[0] * old.optimal_fiber_length, ratios[1] * old.tendon_slack_length),
        )

    def passive_moments(self, parameters: ModelParameters) -> Float[Array, "coordinate sample"]:
        """Compute the joint moments of all muscles without activation, N m."""
        _, force = self._at_rest(parameters, self.length)
        return jnp.einsum("mcs,ms->cs", self.moment_arm, force)

    def normalized_lengths(self, parameters: ModelParameters) -> Float[Array, "muscle frame"]:
        """Compute the normalised fiber lengths in walking, without activation."""
        return self._at_rest(parameters, self.walking)[0]

    def terms(self, variables: Float[Array, " variable"]) -> dict[str, Float[Array, " row"]]:
        """Compute the residuals by term; the cost of a term is the sum of squares of its residuals."""
        parameters, errors = self.lengths(variables), self.errors
        fiber, slack = variables[: 2 * self.muscles].reshape(2, -1)
        largest = variables[2 * self.muscles :]
        length = self.normalized_lengths(parameters)
        group_of = np.zeros(self.muscles, dtype=int)
        for number, members in enumerate(self.groups):
            group_of[list(members)] = number
        count = jnp.bincount(group_of, length=len(self.groups))
        mean = length.mean(axis=1)
        dissimilarity = mean - (jnp.zeros(len(self.groups)).at[group_of].add(mean) / count)[group_of]
        excess = length.max(axis=1) - largest[group_of]
        is_recorded = jnp.asarray(self.recorded)
        error = self.passive_moments(parameters) - jnp.where(is_recorded, self.moment, 0.0)
        # The mask is an array, so that the compiled function does not depend on which moments were recorded.
        weight = is_recorded / jnp.sqrt(jnp.maximum(is_recorded.sum(), 1))
        terms = {
            "fiber_ratio": _rows(fiber - 1.0, errors.fiber_ratio),
            "slack_ratio": _rows(slack - 1.0, errors.slack_ratio),
            "shortest": _rows(jnp.maximum(SHORTEST_FIBER - length.min(axis=1), 0.0), errors.shortest),
            "longest": _rows(excess, errors.longest),
            "group_longest": _rows(largest - 1.0, errors.group_longest),
            "likeness": _rows(dissimilarity, errors.likeness),
        }
        if error.size:
            terms["passive_moment"] = (weight * error).ravel() / errors.passive_moment
        return terms

    def residuals(self, variables: Float[Array, " variable"]) -> Float[Array, " row"]:
        """Compute all residuals as one vector."""
        return jnp.concatenate(list(self.terms(variables).values()))

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Compute the sum of squares of all residuals."""
        return jnp.sum(self.residuals(variables) ** 2)

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compute cost, gradient and both parts of the Hessian by dense derivatives (variables are few)."""
        rows = self.residuals(variables)
        jacobian = jax.jacfwd(self.residuals)(variables)
        gauss_newton = jacobian.T @ jacobian
        hessian = jax.hessian(self.value)(variables) / 2.0
        return Linearization(
            cost=rows @ rows,
            gradient=jacobian.T @ rows,
            gauss_newton=gauss_newton,
            remainder=hessian - gauss_newton,
        )

    def _at_rest(
        self, parameters: ModelParameters, length: Float[Array, "muscle sample"]
    ) -> tuple[Float[Array, "muscle sample"], Float[Array, "muscle sample"]]:
        """Compute normalised fiber lengths and tendon forces without activation or velocity."""

        def of_muscle(
            length: Float[Array, " sample"], parameters: ModelParameters
        ) -> tuple[Float[Array, " sample"], Float[Array, " sample"]]:
            zero = jnp.zeros_like(length)
            fiber = rigid_tendon_fiber(self.curves, zero, length, zero, **fiber_parameters(parameters))
            return fiber.normalized_length, fiber.passive_force

        return jax.vmap(of_muscle)(length, parameters)


def _rows(values: Float[Array, " row"], allowable_error: float) -> Float[Array, " row"]:
    """Divide by the allowable error and the root of the number of values."""
    return values / (allowable_error * np.sqrt(values.size))
