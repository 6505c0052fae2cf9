"""Two legs of one person, calibrated together.

Muscles of the same name share what is the person's: activation constants, and fiber and slack lengths as
ratios to the model's. Delays, EMG scales and paths are each leg's own, as electrodes and walking are
(after Meyer et al. 2017, doi:10.1371/journal.pone.0179698).

The legs that are calibrated together, each with its muscle paths and what is free of it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.penalties import Limit
from wrapjax.calibration.problem import fit_for_methods, matching_path_source, method_freedom
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian, ConstrainedSolution
from wrapjax.calibration.solvers.interface import AbstractCalibration, Linearization
from wrapjax.io.files import code_hash, content_hash
from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import ModelParameters
from wrapjax.path_sources.exact import SURFACES, ExactGeometry
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.path_sources.undriven_muscles import STRATEGIES, apply_undriven_strategy, with_synergy_weights
from wrapjax.subject.subject import Subject, read_legs
from wrapjax.subject.synergies import DEFAULT_SYNERGIES

#: What muscles of the same name share, in solver units: ratios of lengths, times.
SHARED = (
    "activation_time_constant",
    "activation_nonlinearity",
    "optimal_fiber_length",
    "tendon_slack_length",
)


class TwoLegObjective(AbstractCalibration):
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

    def with_limits(self, limits: tuple[Limit, ...]) -> TwoLegObjective:
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


def join_leg_objectives(first: Objective, second: Objective) -> TwoLegObjective:
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
    return TwoLegObjective(legs=(first, second), places=places, bounds=bounds, limits=limits)


def leg_solution(solution: ConstrainedSolution, leg: int) -> ConstrainedSolution:
    """Cut one leg's part out of a joint solution: its variables, limits and cost.

    Status, history and largest violation stay those of both; the expansion is that of both legs' cost
    along this leg's variables.
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
    """Name a variable without its side if legs share it."""
    muscle, name = label.rsplit(".", 1)
    if name not in SHARED:
        return None
    return re.sub(r"_[lr]$", "", muscle) + f".{name}"


@dataclass(frozen=True)
class LegSetup:
    """A leg to calibrate: whose, by which paths, and what may move."""

    subject: Subject
    fit: Fit | ExactGeometry
    freedom: Freedom


def build_leg_setups(
    subject: Subject,
    fit: Fit | ExactGeometry | None,
    method: str,
    freedom: Freedom | None,
    undriven: str = STRATEGIES[0],
    synergies: int = DEFAULT_SYNERGIES,
    surfaces: str = SURFACES[0],
) -> list[LegSetup]:
    """Gather what is calibrated together: the subject's leg, and the other one if it is named."""
    subjects = read_legs(subject)
    if len(subjects) == 2 and freedom is not None:
        raise ValueError("a freedom of one's own is for one leg: take other_leg out of subject.toml")
    legs = []
    for read in subjects:
        leg = apply_undriven_strategy(read, undriven, synergies)
        given = fit if read is subject else None
        if isinstance(given, ExactGeometry) and given.engine.muscles != leg.muscles.names:
            given = None  # made before these muscles were driven
        if isinstance(given, Fit) and leg is not read:
            given.require_subject(leg, "fit")
        fitted = given or (fit_for_methods((method,), leg) if fit is None else matching_path_source(fit, leg))
        free = (
            with_synergy_weights(freedom, leg) if freedom else method_freedom(method, leg, fitted, surfaces)
        )
        legs.append(LegSetup(leg, fitted, free))
    return legs


@dataclass(frozen=True)
class MuscleOptions:
    """Of muscles: the names of their Hill curves and tendons."""

    curves: str = "paper"
    tendon: str = "rigid"


def calibration_fingerprint(
    legs: list[LegSetup], solver: AugmentedLagrangian, law: MuscleOptions, starts: int, seed: int
) -> str:
    """Name a calibration by all that decides where it goes."""
    return content_hash(code_hash(), *map(_fingerprint, legs), repr((solver, law, starts, seed)))


def _fingerprint(leg: LegSetup) -> str:
    """Name a leg's part in a calibration by all that decides where it goes."""
    subject, trials = leg.subject, leg.subject.trials
    return content_hash(
        subject.model_file,
        leg.fit.key,
        repr(subject.muscles),
        trials.moments,
        trials.emg,
        trials.angles,
        repr((trials.names, trials.uses, trials.moment_coordinates, subject.muscle_channels)),
        repr((subject.activation_groups, subject.fiber_length_groups)),
        repr(leg.freedom),
        *(() if subject.synergies is None else (repr(subject.synergies.basis),)),
    )
