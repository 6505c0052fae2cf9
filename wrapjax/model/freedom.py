"""Freedoms: named selections of the parameter tree with bounds, scales and priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS
from wrapjax.model.parameters import QUANTITIES, ModelParameters
from wrapjax.muscle.personal_law import LAW_NAMES, LAW_PARAMETERS


@dataclass(frozen=True)
class FreedParameter:
    """Scalar parameter that is freed, with bounds, scale and prior for each muscle.

    Parameters
    ----------
    name
        Name of the leaf of `ModelParameters`.
    lower, upper
        Bounds in the unit of the parameter. They are absolute, so that a calibration in several stages cannot
        exceed them.
    scale
        Size of one solver unit in the unit of the parameter, so that all variables are of order one.
    prior_mean, prior_sd
        Prior mean and prior standard deviation in the unit of the parameter; an infinite deviation means no
        prior.

    Raises
    ------
    ValueError
        If there is no such parameter, an entry is no array with one value a muscle, or a lower bound is above
        its upper bound.
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
        for field in ("lower", "upper", "scale", "prior_mean", "prior_sd"):
            if np.ndim(getattr(self, field)) != 1:
                raise ValueError(f"{self.name}: {field}: expected an array with one value a muscle")
        if not (self.lower <= self.upper).all():
            raise ValueError(f"{self.name}: a lower bound is above its upper bound")


@dataclass(frozen=True)
class FreedPaths:
    """Muscle paths that may change by linear combinations of their modes.

    Parameters
    ----------
    free
        Whether each mode of each muscle is free; at least one is.
    prior_sd
        Prior standard deviation: root mean square over muscles of the norm of the mode coefficients of a
        muscle.
    """

    free: Bool[np.ndarray, "muscle mode"]
    prior_sd: float

    @property
    def muscles(self) -> Bool[np.ndarray, " muscle"]:
        """Whether a muscle has any free mode."""
        return np.asarray(self.free.any(axis=1))


@dataclass(frozen=True)
class FreedWraps:
    """Wraps whose parameters are freed, each shared by all muscles that wrap round it.

    Parameters
    ----------
    names
        Names of the wraps.
    quantities, units
        Names and units of the wrap parameters, the first of `PARAMETERS`.
    places
        Index in ``names`` of each wrap of each muscle's path; -1 for a wrap that is held, and where a muscle
        has fewer wraps than others.
    lower, upper
        Bounds of the difference of each wrap parameter from its nominal value, in its unit. Both are zero
        for a parameter that is held, because paths do not depend on it.
    scale
        Size of one solver unit, in the unit of the wrap parameter.
    prior_sd
        Prior standard deviation of that difference, in its unit; the prior mean is zero.
    """

    names: tuple[str, ...]
    quantities: tuple[str, ...]
    units: tuple[str, ...]
    places: Int[np.ndarray, "muscle place"]
    lower: Float[np.ndarray, "wrap wrap_parameter"]
    upper: Float[np.ndarray, "wrap wrap_parameter"]
    scale: Float[np.ndarray, "wrap wrap_parameter"]
    prior_sd: Float[np.ndarray, "wrap wrap_parameter"]

    @property
    def free(self) -> Bool[np.ndarray, "wrap wrap_parameter"]:
        """Whether each wrap parameter is free; others are held."""
        return np.asarray(self.upper > self.lower)

    @property
    def nominal(self) -> Float[np.ndarray, " wrap_parameter"]:
        """Parameters of a wrap as the model has it."""
        return NOMINAL_PARAMETERS[: len(self.quantities)]

    def values_of(
        self, path_changes: Float[np.ndarray, "muscle mode"]
    ) -> Float[np.ndarray, "wrap wrap_parameter"]:
        """Compute each wrap's parameters from the path changes of its muscles."""
        return self.nominal + self.changes_of(path_changes)

    def changes_of(
        self, path_changes: Float[np.ndarray, "muscle mode"]
    ) -> Float[np.ndarray, "wrap wrap_parameter"]:
        """Extract each wrap's difference from its nominal parameters from the path changes of its muscles."""
        by_place = np.asarray(path_changes).reshape(*self.places.shape, len(self.quantities))
        return np.stack([by_place[self.places == number][0] for number in range(len(self.names))])


@dataclass(frozen=True)
class FreedSynergies:
    """Freed synergy weights: excitations of muscles without a channel as weighted sums of commands.

    One set of weights serves all cycles of a subject. Separate weights for each cycle, the NMSM Pipeline's
    default, cannot predict cycles that were not part of the calibration.

    Parameters
    ----------
    names
        Names of the excitations.
    places
        Index in ``names`` of the excitation of each muscle; -1 for a muscle with a channel.
    commands
        Number of weights of an excitation; the last is that of the constant command.
    bound
        Largest absolute value of a weight.
    prior_sd
        Prior standard deviation of a weight; the prior mean is zero.
    """

    names: tuple[str, ...]
    places: Int[np.ndarray, " muscle"]
    commands: int
    bound: float
    prior_sd: float

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the weights of one excitation."""
        return synergy_labels(self.commands)


@dataclass(frozen=True)
class FreedLaw:
    """Freed parameters of the person's muscle law, which all muscles share; see `personal_law`.

    Parameters
    ----------
    names
        Names of the parameters.
    lower, upper, prior_sd
        Bounds and prior standard deviations; the prior mean is zero, the given law.
    """

    names: tuple[str, ...]
    lower: Float[np.ndarray, " law_parameter"]
    upper: Float[np.ndarray, " law_parameter"]
    prior_sd: Float[np.ndarray, " law_parameter"]

    @classmethod
    def published(cls) -> FreedLaw:
        """Free all parameters of the family within the spread of published laws."""
        columns = {
            name: np.array([getattr(parameter, name) for parameter in LAW_PARAMETERS])
            for name in ("lower", "upper", "prior_sd")
        }
        return cls(LAW_NAMES, **columns)


def synergy_labels(commands: int) -> tuple[str, ...]:
    """List the names of the weights of one excitation; the last is that of the constant command."""
    return (*(f"synergy_weight_{number}" for number in range(1, commands)), "synergy_offset")


@dataclass(frozen=True)
class Freedom:
    """Selection of the parameter tree that a calibration adjusts, with bounds, scales and priors.

    Parameters
    ----------
    name
        Name of the selection, usually that of a method.
    parameters
        Freed scalar parameters.
    paths
        Freed path modes; None where the paths are held. Excludes ``wraps``.
    wraps
        Freed wraps; None where these are held.
    synergies
        Freed synergy weights; None where every muscle has a channel.
    law
        Freed parameters of the muscle law; None where the law is given.

    Raises
    ------
    ValueError
        If both path modes and wraps are freed, or a parameter twice.
    """

    name: str
    parameters: tuple[FreedParameter, ...]
    paths: FreedPaths | None = None
    wraps: FreedWraps | None = None
    synergies: FreedSynergies | None = None
    law: FreedLaw | None = None

    def __post_init__(self):
        if self.paths is not None and self.wraps is not None:
            raise ValueError("either the modes of paths or their wraps can be free, not both")
        names = [parameter.name for parameter in self.parameters]
        if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
            raise ValueError(f"{', '.join(twice)}: freed twice")

    @property
    def moving_paths(self) -> Bool[np.ndarray, " muscle"] | None:
        """Whether each muscle's path may change; None where all paths are held."""
        if self.paths is not None:
            return self.paths.muscles
        return None if self.wraps is None else np.asarray((self.wraps.places >= 0).any(axis=1))

    def without(self, names: Sequence[str]) -> Freedom:
        """Return the freedom with the named scalar parameters held.

        Raises
        ------
        ValueError
            If one of them is not free.
        """
        free = [parameter.name for parameter in self.parameters]
        if unknown := [name for name in names if name not in free]:
            raise ValueError(f"{', '.join(unknown)}: not free; free are {', '.join(free)}")
        kept = tuple(parameter for parameter in self.parameters if parameter.name not in names)
        return replace(self, parameters=kept)

    def with_held_paths(self) -> Freedom:
        """Return the freedom with all paths held."""
        return replace(self, paths=None, wraps=None)


def nga_freedom(reference: ModelParameters, *, delay_sd: float = 0.05) -> Freedom:
    """Build the freedom of the method NGA: delay, activation, EMG scale, fiber and slack lengths.

    Bounds, scales and priors are those of the NMSM Pipeline: delay 0 to 125 ms, activation time constant 7.5
    to 35 ms (prior 15 +- 20 ms), nonlinearity 0 to 0.35 (0 +- 0.1), EMG scale 0.05 to 1 (0.3 +- 0.2), lengths
    within 40 % of the reference (+- 0.1 m). A prior on the delay is added: the Pipeline's cost has none, and
    the delay then tends to its upper bound.

    Parameters
    ----------
    reference
        Parameters of the model, about which the bounds of the lengths are set.
    delay_sd
        Standard deviation of the prior on the delay about 50 ms, s; infinite for the Pipeline's cost.

    Returns
    -------
    Freedom
        Freedom with all paths held.
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
    """Add path modes to a freedom, of all muscles (SGA) or of those that touch a wrap (LSGA).

    Parameters
    ----------
    freedom
        Freedom to extend.
    name
        Name of the new freedom.
    free, prior_sd
        See `FreedPaths`.
    """
    return replace(freedom, name=name, paths=FreedPaths(free, prior_sd), wraps=None)


def with_wraps(freedom: Freedom, name: str, wraps: FreedWraps) -> Freedom:
    """Add wraps to a freedom (PGA); ``name`` is that of the new freedom."""
    return replace(freedom, name=name, paths=None, wraps=wraps)


#: Largest absolute value of a synergy weight. The NMSM Pipeline has 100. EMG limited to 0 to 1 needs no more
#: than this, and random starts, which lie a part of the way to the bounds, avoid the constant ends of
#: `wrapjax.muscle.excitation.smooth_unit_clip`.
SYNERGY_WEIGHT = 5.0
#: Standard deviation of the prior on a synergy weight about zero (not in the NMSM Pipeline). Commands are in
#: units of normalised EMG, so that components of small variance, which are mostly noise, contribute little.
SYNERGY_PRIOR_SD = 1.0


def with_synergies(
    freedom: Freedom, names: tuple[str, ...], places: Int[np.ndarray, " muscle"], commands: int
) -> Freedom:
    """Add synergy weights to a freedom; see `FreedSynergies` for the parameters."""
    freed = FreedSynergies(names, places, commands, SYNERGY_WEIGHT, SYNERGY_PRIOR_SD)
    return replace(freedom, synergies=freed)
