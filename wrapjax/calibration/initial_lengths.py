"""Fiber and slack lengths from passive joint moments and from where fibers work in walking.

The terms and their allowable errors are those of the NMSM Pipeline's length initialisation, after Meyer et
al. 2017 (doi:10.1371/journal.pone.0179698). Two things are other: a group's likeness is the mean square of
differences from its mean, where the Pipeline takes the largest, which has kinks; and strengths stay.
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

#: Bounds of the ratios of lengths to the model's, and of the largest normalised length of a group.
RATIOS = (0.5, 2.0)
LONGEST = (1.0, 1.2)
#: Normalised length that fibers should not fall below in walking.
SHORTEST = 0.6


class LengthErrors(eqx.Module):
    """Allowable error of each term; the weight of a term is one over its square."""

    #: N m
    passive_moment: float = 2.0
    #: Of the ratios of lengths to the model's, about 1.
    fiber_ratio: float = 0.3
    slack_ratio: float = 1.0
    #: What the shortest normalised length in walking falls below `SHORTEST` by.
    shortest: float = 0.3
    #: What the longest differs by from its group's value; and that value from 1.
    longest: float = 0.03
    group_longest: float = 0.1
    #: What the mean differs by from its group's mean.
    likeness: float = 0.1


class InitialLengthObjective(AbstractLeastSquares):
    """Passive moments and operating ranges as one least-squares problem.

    Variables are the ratios of optimal fiber lengths to the model's, those of slack lengths, and the longest
    normalised length of each group; a muscle in no group is one by itself.
    """

    curves: AbstractCurves
    #: Of all muscles, before.
    parameters: ModelParameters
    #: Muscle-tendon lengths in walking, m.
    walking: Float[Array, "muscle frame"]
    #: The same where moments were recorded with muscles at rest, their moment arms, and these moments (N m).
    length: Float[Array, "muscle sample"]
    moment_arm: Float[Array, "muscle coordinate sample"]
    moment: Float[Array, "coordinate sample"]
    #: Which of these moments were recorded.
    recorded: Bool[Array | np.ndarray, "coordinate sample"]
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    errors: LengthErrors = eqx.field(default_factory=LengthErrors)

    @property
    def muscles(self) -> int:
        """How many there are."""
        return self.walking.shape[0]

    @property
    def lower(self) -> Float[np.ndarray, " variable"]:
        """Lower bounds."""
        return np.append(np.full(2 * self.muscles, RATIOS[0]), np.full(len(self.groups), LONGEST[0]))

    @property
    def upper(self) -> Float[np.ndarray, " variable"]:
        """Upper bounds."""
        return np.append(np.full(2 * self.muscles, RATIOS[1]), np.full(len(self.groups), LONGEST[1]))

    def start(self) -> Float[Array, " variable"]:
        """Give the model's own lengths."""
        return jnp.ones(2 * self.muscles + len(self.groups))

    def lengths(self, variables: Float[Array, " variable"]) -> ModelParameters:
        """Put the ratios into the parameter tree."""
        ratios = variables[: 2 * self.muscles].reshape(2, -1)
        old = self.parameters
        return eqx.tree_at(
            lambda tree: (tree.optimal_fiber_length, tree.tendon_slack_length),
            old,
            (ratios[0] * old.optimal_fiber_length, ratios[1] * old.tendon_slack_length),
        )

    def passive_moments(self, parameters: ModelParameters) -> Float[Array, "coordinate sample"]:
        """Sum the moments of all muscles at rest, N m."""
        _, force = self._at_rest(parameters, self.length)
        return jnp.einsum("mcs,ms->cs", self.moment_arm, force)

    def normalized_lengths(self, parameters: ModelParameters) -> Float[Array, "muscle frame"]:
        """Give fiber lengths in walking, in optimal fiber lengths."""
        return self._at_rest(parameters, self.walking)[0]

    def terms(self, variables: Float[Array, " variable"]) -> dict[str, Float[Array, " row"]]:
        """Residuals by term; the cost of a term is the sum of squares of its residuals."""
        parameters, errors = self.lengths(variables), self.errors
        fiber, slack = variables[: 2 * self.muscles].reshape(2, -1)
        largest = variables[2 * self.muscles :]
        length = self.normalized_lengths(parameters)
        group_of = np.zeros(self.muscles, dtype=int)
        for number, members in enumerate(self.groups):
            group_of[list(members)] = number
        count = jnp.bincount(group_of, length=len(self.groups))
        mean = length.mean(axis=1)
        unlike = mean - (jnp.zeros(len(self.groups)).at[group_of].add(mean) / count)[group_of]
        excess = length.max(axis=1) - largest[group_of]
        known = jnp.asarray(self.recorded)
        missed = self.passive_moments(parameters) - jnp.where(known, self.moment, 0.0)
        # A share of each: which were recorded is data, as everything of a person is.
        share = known / jnp.sqrt(jnp.maximum(known.sum(), 1))
        terms = {
            "fiber_ratio": _rows(fiber - 1.0, errors.fiber_ratio),
            "slack_ratio": _rows(slack - 1.0, errors.slack_ratio),
            "shortest": _rows(jnp.maximum(SHORTEST - length.min(axis=1), 0.0), errors.shortest),
            "longest": _rows(excess, errors.longest),
            "group_longest": _rows(largest - 1.0, errors.group_longest),
            "likeness": _rows(unlike, errors.likeness),
        }
        if missed.size:
            terms["passive_moment"] = (share * missed).ravel() / errors.passive_moment
        return terms

    def residuals(self, variables: Float[Array, " variable"]) -> Float[Array, " row"]:
        """All residuals as one vector."""
        return jnp.concatenate(list(self.terms(variables).values()))

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Sum of squares of all residuals."""
        return jnp.sum(self.residuals(variables) ** 2)

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compute cost, gradient and both parts of the Hessian, dense: variables are few."""
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
        """Normalised lengths, and forces along the tendon without activation."""

        def of_one(
            length: Float[Array, " sample"], parameters: ModelParameters
        ) -> tuple[Float[Array, " sample"], Float[Array, " sample"]]:
            nothing = jnp.zeros_like(length)
            fiber = rigid_tendon_fiber(self.curves, nothing, length, nothing, **fiber_parameters(parameters))
            return fiber.normalized_length, fiber.passive_force

        return jax.vmap(of_one)(length, parameters)


def _rows(values: Float[Array, " row"], allowable_error: float) -> Float[Array, " row"]:
    """Divide by the allowable error and the root of how many values there are."""
    return values / (allowable_error * np.sqrt(values.size))
