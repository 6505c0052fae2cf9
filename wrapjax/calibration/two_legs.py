"""Joint calibration of the two legs of a subject.

Muscles of the same name in both legs share their activation constants, and their fiber and slack lengths
relative to the model's. Delays, EMG scales and paths differ between legs, because electrodes and gait do
(after Meyer et al. 2017, doi:10.1371/journal.pone.0179698).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.penalties import Limit
from wrapjax.calibration.solvers.augmented_lagrangian import ConstrainedSolution
from wrapjax.calibration.solvers.interface import (
    AbstractCalibration,
    AbstractLinearizedLimits,
    Linearization,
)
from wrapjax.model.parameters import ModelParameters

#: Parameters that muscles of the same name share, in solver units: ratios of lengths, times.
SHARED = (
    "activation_time_constant",
    "activation_nonlinearity",
    "optimal_fiber_length",
    "tendon_slack_length",
)


class TwoLegObjective(AbstractCalibration):
    """Sum of the objectives of two legs over their joint variables, some of which are shared."""

    legs: tuple[Objective, Objective]
    #: Index among the joint variables of each variable of each leg.
    places: tuple[Int[np.ndarray, " own"], Int[np.ndarray, " own"]]
    #: Lower and upper bounds of the joint variables.
    bounds: Float[np.ndarray, "2 variable"]
    #: Limits of the first leg, then those of the second.
    limits: tuple[Limit, ...]

    @property
    def lower(self) -> Float[Array | np.ndarray, " variable"]:
        """Lower bounds; the higher one where a variable is shared."""
        return self.bounds[0]

    @property
    def upper(self) -> Float[Array | np.ndarray, " variable"]:
        """Upper bounds; the lower one where a variable is shared."""
        return self.bounds[1]

    @property
    def resolution(self) -> float:
        """Larger resolution of the two legs."""
        return max(leg.resolution for leg in self.legs)

    def with_limits(self, limits: tuple[Limit, ...]) -> TwoLegObjective:
        """Return the objective with other limits, in the same order."""
        first = len(self.legs[0].limits)
        own = (limits[:first], limits[first:])
        legs = [leg.with_limits(given) for leg, given in zip(self.legs, own, strict=True)]
        return replace(self, legs=(legs[0], legs[1]), limits=limits)

    @property
    def initial(self) -> tuple[ModelParameters, ModelParameters]:
        """Parameter trees before calibration."""
        return self.legs[0].initial, self.legs[1].initial

    def parameters(self, variables: Float[Array, " variable"]) -> tuple[ModelParameters, ModelParameters]:
        """Insert variables into the two parameter trees."""
        first, second = (
            leg.parameters(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)
        )
        return first, second

    def start(self, parameters: tuple[ModelParameters, ModelParameters]) -> Float[Array, " variable"]:
        """Extract the variables from the trees, shared ones from the first, and clip them to the bounds."""
        joint = jnp.zeros(self.bounds.shape[1])
        for leg, place, tree in zip(self.legs[::-1], self.places[::-1], parameters[::-1], strict=True):
            joint = joint.at[place].set(leg.start(tree))
        return jnp.clip(joint, self.lower, self.upper)

    def excess(self, variables: Float[Array, " variable"]) -> tuple[Float[Array, "muscle _"], ...]:
        """Compute the excess of each limited value over its bound, by limit."""
        first, second = (
            leg.excess(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)
        )
        return first + second

    def residuals(self, variables: Float[Array, " variable"]) -> Float[Array, " row"]:
        """Compute the residuals of both legs as one vector."""
        return jnp.concatenate(
            [leg.residuals(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)]
        )

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Compute the sum of the costs of both legs."""
        first, second = (
            leg.value(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)
        )
        return first + second

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Sum the second-order expansions of both legs over the joint variables."""
        return self._sum_expansions(
            [leg.linearize(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)]
        )

    def linearized_at(self, variables: Float[Array, " variable"]) -> Linearization:
        """Evaluate `linearize` by one compiled function per leg.

        Legs usually have the same shapes, so that the function compiled for one serves the other; one
        function for both would take twice as long to compile.
        """
        return self._sum_expansions(
            [leg.linearized_at(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)]
        )

    def value_at(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Evaluate `value` by one compiled function per leg."""
        first, second = (
            leg.value_at(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)
        )
        return first + second

    def _sum_expansions(self, expansions: Sequence[Linearization]) -> Linearization:
        count = self.bounds.shape[1]
        limits = _join_limits([expansion.limits for expansion in expansions], self.places, count)
        total = Linearization(
            jnp.zeros(()), jnp.zeros(count), jnp.zeros((count, count)), jnp.zeros((count, count)), limits
        )
        for own, place in zip(expansions, self.places, strict=True):
            rows, columns = jnp.asarray(place)[:, None], jnp.asarray(place)[None]
            total = Linearization(
                cost=total.cost + own.cost,
                gradient=total.gradient.at[place].add(own.gradient),
                gauss_newton=total.gauss_newton.at[rows, columns].add(own.gauss_newton),
                remainder=total.remainder.at[rows, columns].add(own.remainder),
                limits=limits,
            )
        return total


class TwoLegLimits(AbstractLinearizedLimits):
    """Limits of the first leg, then those of the second, about a point of the joint variables."""

    excess: Float[Array, " row"]
    weight: Float[Array, " row"]
    legs: tuple[AbstractLinearizedLimits, ...]
    places: tuple[Int[np.ndarray, " own"], Int[np.ndarray, " own"]]
    #: Number of joint variables.
    count: int = eqx.field(static=True)

    def change(self, move: Float[Array, " variable"]) -> Float[Array, " row"]:
        """Compute the change of the excess by a move."""
        return jnp.concatenate(
            [leg.change(move[place]) for leg, place in zip(self.legs, self.places, strict=True)]
        )

    def gradient(self, multipliers: Float[Array, " row"]) -> Float[Array, " variable"]:
        """Compute the sum of the gradients of the excesses, times multipliers."""
        total = jnp.zeros(self.count)
        for leg, place, own in self._by_leg(multipliers):
            total = total.at[place].add(leg.gradient(own))
        return total

    def gram(self, weights: Float[Array, " row"]) -> Float[Array, "variable variable"]:
        """Compute the sum of the outer products of the gradients of the excesses, times weights."""
        total = jnp.zeros((self.count, self.count))
        for leg, place, own in self._by_leg(weights):
            total = total.at[jnp.asarray(place)[:, None], jnp.asarray(place)[None]].add(leg.gram(own))
        return total

    def _by_leg(
        self, rows: Float[Array, " row"]
    ) -> Iterator[tuple[AbstractLinearizedLimits, Int[np.ndarray, " own"], Float[Array, " _"]]]:
        yield from zip(self.legs, self.places, jnp.split(rows, [self.legs[0].excess.size]), strict=True)


def _join_limits(
    limits: Sequence[AbstractLinearizedLimits | None],
    places: tuple[Int[np.ndarray, " own"], Int[np.ndarray, " own"]],
    count: int,
) -> TwoLegLimits | None:
    """Join the limits of both legs; None if a leg has none, as where all paths are held."""
    legs = tuple(own for own in limits if own is not None)
    if len(legs) < len(limits):
        return None
    excess, weight = (jnp.concatenate([getattr(leg, name) for leg in legs]) for name in ("excess", "weight"))
    return TwoLegLimits(excess, weight, legs, places, count)


def join_leg_objectives(first: Objective, second: Objective) -> TwoLegObjective:
    """Join the objectives of two legs; muscles are matched by name without the side (``soleus_l``).

    A muscle of one leg alone shares no parameters.

    Parameters
    ----------
    first, second
        Objectives of the legs; shared variables have the values of the first one at the start.

    Raises
    ------
    ValueError
        If the bounds of the legs on a shared variable do not overlap.
    """
    labels = [leg.variables.labels for leg in (first, second)]
    place_of = {_shared_name(label): place for place, label in enumerate(labels[0])}
    count = len(labels[0])
    second_places = []
    for label in labels[1]:
        name = _shared_name(label)
        if name is not None and name in place_of:
            second_places.append(place_of[name])
        else:
            second_places.append(count)
            count += 1
    places = np.arange(len(labels[0])), np.array(second_places)
    bounds = np.repeat([[-np.inf], [np.inf]], count, axis=1)
    for leg, place in zip((first, second), places, strict=True):
        bounds[0, place] = np.maximum(bounds[0, place], np.asarray(leg.lower))
        bounds[1, place] = np.minimum(bounds[1, place], np.asarray(leg.upper))
    disjoint = [
        label
        for label, place in zip(labels[1], places[1], strict=True)
        if bounds[0, place] > bounds[1, place]
    ]
    if disjoint:
        raise ValueError(f"the legs' bounds on {disjoint[0]} have nothing in common")
    limits = first.limits + second.limits
    return TwoLegObjective(legs=(first, second), places=places, bounds=bounds, limits=limits)


def leg_solution(solution: ConstrainedSolution, leg: int) -> ConstrainedSolution:
    """Extract the variables, limits and cost of one leg from a joint solution.

    Status, history and largest violation are those of both legs; the expansion is that of the joint cost in
    the variables of this leg.

    Parameters
    ----------
    solution
        Solution of a `TwoLegObjective`.
    leg
        Number of the leg, 0 or 1.
    """
    joint = solution.problem
    assert isinstance(joint, TwoLegObjective)
    problem, place = joint.legs[leg], joint.places[leg]
    variables, expansion = solution.variables[place], solution.linearization
    block = np.ix_(place, place)
    return replace(
        solution,
        variables=variables,
        cost=float(problem.value_at(jnp.asarray(variables))),
        linearization=Linearization(
            cost=expansion.cost,
            gradient=expansion.gradient[place],
            gauss_newton=expansion.gauss_newton[block],
            remainder=expansion.remainder[block],
        ),
        problem=problem,
    )


def _shared_name(label: str) -> str | None:
    """Return the name of a shared variable without its side; None if it is not shared."""
    muscle, name = label.rsplit(".", 1)
    if name not in SHARED:
        return None
    return re.sub(r"_[lr]$", "", muscle) + f".{name}"
