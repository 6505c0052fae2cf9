"""Freedoms: named selections from the parameter tree, with bounds and scales."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.model.parameters import QUANTITIES, ModelParameters


@dataclass(frozen=True)
class FreedParameter:
    """One leaf of the parameter tree that may move.

    Parameters
    ----------
    name
        Leaf of `ModelParameters`.
    lower, upper
        Bounds in the leaf's own unit. They belong to the freedom and do not follow the parameters:
        calibrating in several stages cannot creep past them.
    scale
        Size of one solver unit, so that all variables are of order one.
    prior_mean, prior_sd
        Where the parameter is expected and how far it may be from there at the cost of one
        allowable error; an infinite deviation expects nothing.
    """

    name: str
    lower: Float[np.ndarray, " muscle"]
    upper: Float[np.ndarray, " muscle"]
    scale: Float[np.ndarray, " muscle"]
    prior_mean: Float[np.ndarray, " muscle"]
    prior_sd: Float[np.ndarray, " muscle"]

    def __post_init__(self):
        if self.name not in QUANTITIES:
            raise ValueError(f"'{self.name}' is no model parameter; there are {', '.join(QUANTITIES)}")
        if not (self.lower <= self.upper).all():
            raise ValueError(f"{self.name}: a lower bound is above its upper bound")


@dataclass(frozen=True)
class FreedPaths:
    """Paths that may change by any sum of their modes.

    Parameters
    ----------
    free
        Which modes of which muscles; at least one.
    prior_sd
        Length of a muscle's vector of changes, root mean square over muscles, that costs one
        allowable error.
    """

    free: Bool[np.ndarray, "muscle mode"]
    prior_sd: float

    @property
    def muscles(self) -> Bool[np.ndarray, " muscle"]:
        """Whether a muscle has any free mode."""
        return np.asarray(self.free.any(axis=1))


@dataclass(frozen=True)
class FreedWraps:
    """Cylinders whose parameters may change, each alike for all muscles that wrap round it.

    Parameters
    ----------
    names
        Of the cylinders.
    quantities, units
        Names and units of a cylinder's parameters, by which it may differ from nominal.
    places
        Which cylinder stands in each place of a muscle's path: a number in ``names``, -1 for one that
        is held and where a muscle has fewer.
    lower, upper
        Bounds of what each parameter may differ from nominal by, in its unit.
    scale
        Size of one solver unit.
    prior_sd
        How far a parameter may be from nominal at the cost of one allowable error.
    """

    names: tuple[str, ...]
    quantities: tuple[str, ...]
    units: tuple[str, ...]
    places: Int[np.ndarray, "muscle place"]
    lower: Float[np.ndarray, "wrap wrap_parameter"]
    upper: Float[np.ndarray, "wrap wrap_parameter"]
    scale: Float[np.ndarray, "wrap wrap_parameter"]
    prior_sd: Float[np.ndarray, "wrap wrap_parameter"]

    def changes_of(
        self, path_changes: Float[np.ndarray, "muscle mode"]
    ) -> Float[np.ndarray, "wrap wrap_parameter"]:
        """Read each cylinder's difference from nominal off the muscles that wrap round it."""
        by_place = np.asarray(path_changes).reshape(*self.places.shape, len(self.quantities))
        return np.stack([by_place[self.places == number][0] for number in range(len(self.names))])


@dataclass(frozen=True)
class FreedSynergies:
    """Excitations of muscles without a channel, each a weighted sum of commands.

    Weights are one set for all cycles of a person. Sets of a cycle's own, which the NMSM Pipeline has by
    default, predict no cycle that was not calibrated on.

    Parameters
    ----------
    names
        Of the excitations.
    places
        Which excitation drives each muscle: a number in ``names``, -1 for one that has a channel.
    commands
        How many weights an excitation has; the last is of the constant.
    bound
        Largest size of a weight.
    prior_sd
        How far a weight may be from zero at the cost of one allowable error.
    """

    names: tuple[str, ...]
    places: Int[np.ndarray, " muscle"]
    commands: int
    bound: float
    prior_sd: float

    @property
    def labels(self) -> tuple[str, ...]:
        """Name the weights of one excitation."""
        return synergy_labels(self.commands)


def synergy_labels(commands: int) -> tuple[str, ...]:
    """Name the weights of one excitation, the last of the constant."""
    return (*(f"synergy_weight_{number}" for number in range(1, commands)), "synergy_offset")


@dataclass(frozen=True)
class Freedom:
    """A named set of freed parameters, and of what may change of the paths: their modes, or cylinders.

    Where muscles have no channel, also what drives them.
    """

    name: str
    parameters: tuple[FreedParameter, ...]
    paths: FreedPaths | None = None
    wraps: FreedWraps | None = None
    synergies: FreedSynergies | None = None

    def __post_init__(self):
        if self.paths is not None and self.wraps is not None:
            raise ValueError("either the modes of paths or their cylinders can be free, not both")

    @property
    def moving_paths(self) -> Bool[np.ndarray, " muscle"] | None:
        """Whether a muscle's path may change; None where all are held."""
        if self.paths is not None:
            return self.paths.muscles
        return None if self.wraps is None else np.asarray((self.wraps.places >= 0).any(axis=1))

    def without(self, names: Sequence[str]) -> Freedom:
        """Hold the named parameters at their values."""
        kept = tuple(parameter for parameter in self.parameters if parameter.name not in names)
        return replace(self, parameters=kept)

    def with_held_paths(self) -> Freedom:
        """Hold all paths as they are."""
        return replace(self, paths=None, wraps=None)


def nga_freedom(reference: ModelParameters, *, delay_sd: float = 0.05) -> Freedom:
    """Free what needs no geometry: delay, activation, EMG scale, fiber and slack lengths.

    Bounds, units and priors are the NMSM Pipeline's: delay 0 to 125 ms, activation time constant 7.5
    to 35 ms (15 +- 20), nonlinearity 0 to 0.35 (0 +- 0.1), EMG scale 0.05 to 1 (0.3 +- 0.2), lengths
    within 40 % of the reference (+- 0.1 m). One prior is added: nothing in the Pipeline's cost holds
    the delay, which then runs to its upper bound.

    Parameters
    ----------
    reference
        The model's own parameters, about which the bounds of the lengths are set.
    delay_sd
        Spread of the prior on the delay about 50 ms, in s; infinite for the Pipeline's own cost.
    """
    ones = np.ones(len(reference.emg_scale))

    def within(name: str, lower: float, upper: float, scale: float, mean: float, sd: float) -> FreedParameter:
        return FreedParameter(name, lower * ones, upper * ones, scale * ones, mean * ones, sd * ones)

    def about_reference(name: str) -> FreedParameter:
        length = np.asarray(getattr(reference, name))
        return FreedParameter(name, 0.6 * length, 1.4 * length, length, length, 0.1 * ones)

    return Freedom(
        "NGA",
        (
            within("electromechanical_delay", 0.0, 0.125, 0.1, 0.05, delay_sd),
            within("activation_time_constant", 0.0075, 0.035, 0.01, 0.015, 0.02),
            within("activation_nonlinearity", 0.0, 0.35, 1.0, 0.0, 0.1),
            within("emg_scale", 0.05, 1.0, 1.0, 0.3, 0.2),
            about_reference("optimal_fiber_length"),
            about_reference("tendon_slack_length"),
        ),
    )


def with_paths(
    freedom: Freedom, name: str, free: Bool[np.ndarray, "muscle mode"], *, prior_sd: float
) -> Freedom:
    """Free paths as well: of all muscles (SGA), or of those that touch a wrapping surface (LSGA).

    Parameters
    ----------
    freedom
        What else may move.
    name
        Of the new freedom.
    free, prior_sd
        See `FreedPaths`.
    """
    return replace(freedom, name=name, paths=FreedPaths(free, prior_sd), wraps=None)


def with_wraps(freedom: Freedom, name: str, wraps: FreedWraps) -> Freedom:
    """Free cylinders as well (PGA)."""
    return replace(freedom, name=name, paths=None, wraps=wraps)


#: Largest size of a synergy's weight. The Pipeline has 100; EMG that is held within 0 and 1 needs no more
#: than this, and random starts, which go a part of the way to the bounds, stay where it is not level.
SYNERGY_WEIGHT = 5.0
#: Spread of the prior on a synergy's weight about zero. Ours: commands are in units of normalised EMG, so
#: that components of little variance, which are mostly noise, add little.
SYNERGY_PRIOR_SD = 1.0


def with_synergies(
    freedom: Freedom, names: tuple[str, ...], places: Int[np.ndarray, " muscle"], commands: int
) -> Freedom:
    """Free the weights of synergies as well; see `FreedSynergies`."""
    freed = FreedSynergies(names, places, commands, SYNERGY_WEIGHT, SYNERGY_PRIOR_SD)
    return replace(freedom, synergies=freed)
