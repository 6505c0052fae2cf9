"""Two legs of one person, calibrated together.

Muscles of the same name share what is the person's: activation constants, and fiber and slack lengths as
ratios to the model's. Delays, EMG scales and paths are each leg's own, as electrodes and walking are
(after Meyer et al. 2017, doi:10.1371/journal.pone.0179698).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.calibrate.augmented_lagrangian import ConstrainedSolution
from wrapjax.calibrate.objective import Objective
from wrapjax.calibrate.penalties import Limit
from wrapjax.calibrate.problem import AbstractCalibration, Linearization
from wrapjax.model import ModelParameters

#: What muscles of the same name share, in solver units: ratios of lengths, times.
SHARED = (
    "activation_time_constant",
    "activation_nonlinearity",
    "optimal_fiber_length",
    "tendon_slack_length",
)


class Legs(AbstractCalibration):
    """The sum of two legs' costs over their joint variables."""

    legs: tuple[Objective, Objective]
    #: Where each leg's variables stand among the joint ones.
    places: tuple[Int[np.ndarray, " own"], Int[np.ndarray, " own"]]
    bounds: Float[np.ndarray, "2 variable"]
    #: The first leg's, then the second's.
    limits: tuple[Limit, ...]

    @property
    def lower(self) -> Float[Array | np.ndarray, " variable"]:
        """Lower bounds; where a variable is shared, the higher."""
        return self.bounds[0]

    @property
    def upper(self) -> Float[Array | np.ndarray, " variable"]:
        """Upper bounds; where a variable is shared, the lower."""
        return self.bounds[1]

    @property
    def resolution(self) -> float:
        """That of the coarser one."""
        return max(leg.resolution for leg in self.legs)

    def with_limits(self, limits: tuple[Limit, ...]) -> Legs:
        """Take others in their place, in the same order."""
        first = len(self.legs[0].limits)
        own = (limits[:first], limits[first:])
        legs = [leg.with_limits(given) for leg, given in zip(self.legs, own, strict=True)]
        return replace(self, legs=(legs[0], legs[1]), limits=limits)

    @property
    def initial(self) -> tuple[ModelParameters, ModelParameters]:
        """Parameter trees before calibration."""
        return self.legs[0].initial, self.legs[1].initial

    def parameters(self, variables: Float[Array, " variable"]) -> tuple[ModelParameters, ModelParameters]:
        """Put variables into the two trees."""
        first, second = (
            leg.parameters(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)
        )
        return first, second

    def start(self, parameters: tuple[ModelParameters, ModelParameters]) -> Float[Array, " variable"]:
        """Read the variables off the trees, shared ones off the first, and move them inside the bounds."""
        joint = jnp.zeros(self.bounds.shape[1])
        for leg, place, tree in zip(self.legs[::-1], self.places[::-1], parameters[::-1], strict=True):
            joint = joint.at[place].set(leg.start(tree))
        return jnp.clip(joint, self.lower, self.upper)

    def excess(self, variables: Float[Array, " variable"]) -> tuple[Float[Array, "muscle _"], ...]:
        """Give how far each limited value is above its bound, by limit."""
        first, second = (
            leg.excess(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)
        )
        return first + second

    def residuals(self, variables: Float[Array, " variable"]) -> Float[Array, " row"]:
        """All residuals of both legs as one vector."""
        return jnp.concatenate(
            [leg.residuals(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)]
        )

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Sum of both legs' costs."""
        first, second = (
            leg.value(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)
        )
        return first + second

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Add up the legs' expansions, each at its own places."""
        return self._added_up(
            [leg.linearize(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)]
        )

    def linearized_at(self, variables: Float[Array, " variable"]) -> Linearization:
        """Expand each leg by a program of its own.

        Legs are alike as a rule, and what is compiled for one serves the other: one program of both would
        take twice as long to compile.
        """
        return self._added_up(
            [leg.linearized_at(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)]
        )

    def value_at(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Sum of both legs' costs, each by a program of its own."""
        first, second = (
            leg.value_at(variables[place]) for leg, place in zip(self.legs, self.places, strict=True)
        )
        return first + second

    def _added_up(self, expansions: Sequence[Linearization]) -> Linearization:
        count = self.bounds.shape[1]
        total = Linearization(
            jnp.zeros(()), jnp.zeros(count), jnp.zeros((count, count)), jnp.zeros((count, count))
        )
        for own, place in zip(expansions, self.places, strict=True):
            rows, columns = jnp.asarray(place)[:, None], jnp.asarray(place)[None]
            total = Linearization(
                cost=total.cost + own.cost,
                gradient=total.gradient.at[place].add(own.gradient),
                gauss_newton=total.gauss_newton.at[rows, columns].add(own.gauss_newton),
                remainder=total.remainder.at[rows, columns].add(own.remainder),
            )
        return total


def join_legs(first: Objective, second: Objective) -> Legs:
    """Join two legs' problems; muscles match by name without the side, ``soleus_l`` and ``soleus_r``.

    A muscle that only one leg has keeps its own parameters.
    """
    labels = [leg.variables.labels for leg in (first, second)]
    known = {_shared_name(label): place for place, label in enumerate(labels[0])}
    count = len(labels[0])
    second_places = []
    for label in labels[1]:
        name = _shared_name(label)
        if name is not None and name in known:
            second_places.append(known[name])
        else:
            second_places.append(count)
            count += 1
    places = np.arange(len(labels[0])), np.array(second_places)
    bounds = np.repeat([[-np.inf], [np.inf]], count, axis=1)
    for leg, place in zip((first, second), places, strict=True):
        bounds[0, place] = np.maximum(bounds[0, place], np.asarray(leg.lower))
        bounds[1, place] = np.minimum(bounds[1, place], np.asarray(leg.upper))
    apart = [
        label
        for label, place in zip(labels[1], places[1], strict=True)
        if bounds[0, place] > bounds[1, place]
    ]
    if apart:
        raise ValueError(f"the legs' bounds on {apart[0]} have nothing in common")
    limits = first.limits + second.limits
    return Legs(legs=(first, second), places=places, bounds=bounds, limits=limits)


def solution_of_leg(solution: ConstrainedSolution, leg: int) -> ConstrainedSolution:
    """Cut one leg's part out of a joint solution: its variables, limits and cost.

    Status, history and largest violation stay those of both; the expansion is that of both legs' cost
    along this leg's variables.
    """
    joint = solution.problem
    assert isinstance(joint, Legs)
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
    """Name a variable without its side if legs share it."""
    muscle, name = label.rsplit(".", 1)
    if name not in SHARED:
        return None
    return re.sub(r"_[lr]$", "", muscle) + f".{name}"
