"""Polynomial muscle paths over a subject's cycles, as functions of path modes or of wrap parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.exact_paths.wrapped_paths import wrapped_paths
from wrapjax.geometry.exact_paths.wrapping import PARAMETERS
from wrapjax.geometry.paths import AdjustablePath, PathState
from wrapjax.geometry.surrogates.feasibility import MIN_CLASS_SHARE, Feasibility
from wrapjax.geometry.surrogates.physiological import PhysiologicalThresholds
from wrapjax.geometry.surrogates.surrogate import PathSurrogate
from wrapjax.geometry.surrogates.two_level import InnerLevel, TwoLevelPaths, two_level_paths
from wrapjax.geometry.surrogates.wrap_bounds import CYLINDER
from wrapjax.model.freedom import Freedom, FreedWraps, nga_freedom, with_paths
from wrapjax.model.parameters import ModelParameters
from wrapjax.path_sources.exact import angles_of_other_trials, build_engine, freed_wraps, recorded_motion
from wrapjax.path_sources.model_inputs import coefficient_paths, model_parameters, surrogate_paths
from wrapjax.path_sources.proximity_paths import ProximityPaths, with_exact_proximity
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

# Allowable changes of lengths and moment arms, in mean and shape, as fractions of the nominal range.
_LENGTH_MEAN, _LENGTH_SHAPE = 1.0, 0.25
_ARM_MEAN, _ARM_SHAPE = 0.5, 0.25
# Shapes of knee, ankle and subtalar moment arms are better known than those of the hip.
_DISTAL_ARM_SHAPE = 0.125
# Smallest range (m). Without it, a quantity that is almost constant could not change at all.
_LEAST_RANGE = 0.01
# Allowable change of a single coefficient, m. It constrains only combinations that the recorded cycles do not
# determine.
_COEFFICIENT = 3e-3
#: Allowable norm of a path's vector of modes, root mean square over muscles. Meyer et al. weigh a norm of one
#: like a moment error of 1 N m, which hardly lets paths change (errors fall by a seventh). This weaker weight
#: only prevents changes that do not reduce moment errors.
PATH_CHANGE = 15.0


@dataclass(frozen=True)
class WrapQuality:
    """Accuracy of the feasibility classifier of one wrap, on samples and poses that were not used in fitting.

    Parameters
    ----------
    physiological_share
        Share of the samples within the parameter bounds that give physiological paths.
    balanced_accuracy, false_physiological
        Accuracy of the classifier together with the exact margins, both of which PGA uses; see
        `wrapjax.geometry.surrogates.feasibility.FeasibilityQuality`. Margins are evaluated in recorded
        poses, and the true class in other poses.
    learned_balanced_accuracy, learned_false_physiological
        Accuracy of the classifier alone.
    near_bone_share
        Share of the samples that stay near the bones of the wrap's body; None where no bone's surface was
        given.
    """

    physiological_share: float
    balanced_accuracy: float | None
    false_physiological: float | None
    learned_balanced_accuracy: float | None = None
    learned_false_physiological: float | None = None
    near_bone_share: float | None = None


@dataclass(frozen=True)
class WrapFit:
    """Inner level of a subject's surrogate, and feasibility classifiers of its wraps.

    Parameters
    ----------
    wraps_of
        Names of the wraps of each muscle, in the order of its path.
    translations
        Largest translation of each wrap along its axes, m.
    classes
        OpenSim's class of each wrap.
    touched
        Names of the wraps that some muscle touches in a recorded frame.
    inner
        Inner level of all muscles, in the order of ``wraps_of``.
    feasibility
        Classifier of each wrap; None where one of the classes has too few samples.
    quality
        Accuracy of the classifier of each wrap.
    thresholds
        Definition of physiological paths.
    """

    wraps_of: dict[str, tuple[str, ...]]
    translations: dict[str, float]
    classes: dict[str, str]
    touched: tuple[str, ...]
    inner: InnerLevel
    feasibility: dict[str, Feasibility | None]
    quality: dict[str, WrapQuality]
    thresholds: PhysiologicalThresholds

    def movable(self, surfaces: str) -> tuple[str, ...]:
        """List the wraps of a choice of `SURFACES`, except those with hardly any physiological sample."""
        candidates = self.touched if surfaces == "touched" else tuple(self.quality)
        return tuple(name for name in candidates if self.quality[name].physiological_share >= MIN_CLASS_SHARE)

    def freed(self, muscles: Sequence[str], surfaces: str = "touched") -> FreedWraps:
        """Free the movable wraps of muscles, listed by name."""
        own = {wrap for name in muscles for wrap in self.wraps_of[name]}
        translations = {name: self.translations[name] for name in self.movable(surfaces) if name in own}
        return freed_wraps(
            [self.wraps_of[name] for name in muscles], translations, self.classes, self.parameters
        )

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the wrap parameters."""
        return PARAMETERS[: self.inner.half_range.shape[-1]]

    def inner_of(self, muscles: Sequence[str], wraps: int) -> InnerLevel:
        """Select the inner level of muscles by name, for the first ``wraps`` wraps of each."""
        rows = np.array([list(self.wraps_of).index(name) for name in muscles])
        return InnerLevel(self.inner.weights[rows, :wraps], self.inner.half_range[rows, :wraps])

    def limits(self, muscles: Sequence[str], wraps: Sequence[str]) -> list[tuple[int, int, Feasibility]]:
        """List the feasibility classifiers of wraps, with a muscle and the place of the wrap in its path."""
        limits = []
        for wrap in wraps:
            feasibility = self.feasibility[wrap]
            row = next(row for row, name in enumerate(muscles) if wrap in self.wraps_of[name])
            if feasibility is not None:
                limits.append((row, self.wraps_of[muscles[row]].index(wrap), feasibility))
        return limits

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all arrays by name, for `wrap_fit_from`."""
        stored = {f"inner.{name}": value for name, value in vars(self.inner).items()}
        for wrap, feasibility in self.feasibility.items():
            if feasibility is not None:
                stored |= {f"feasibility.{wrap}.{name}": value for name, value in vars(feasibility).items()}
        return {name: np.asarray(value) for name, value in stored.items() if eqx.is_array_like(value)}

    def content(self) -> dict[str, dict]:
        """Return the entries of the wraps in ``fit.json``."""
        return {
            name: {
                **vars(quality),
                "surface": self.classes[name],
                "translation_m": self.translations[name],
                "touched": name in self.touched,
            }
            for name, quality in self.quality.items()
        }


def wrap_fit_from(
    arrays: dict[str, np.ndarray],
    content: dict[str, dict],
    wraps_of: dict[str, list[str]],
    thresholds: dict[str, float],
) -> WrapFit:
    """Rebuild a `WrapFit` from `WrapFit.arrays`, `WrapFit.content` and its further fields."""
    names = ("weights", "half_range")
    inner = InnerLevel(**{name: jnp.asarray(arrays[f"inner.{name}"]) for name in names})
    feasibility: dict[str, Feasibility | None] = {}
    for wrap in content:
        prefix = f"feasibility.{wrap}."
        own = {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
        limit = {name: jnp.asarray(value) for name, value in own.items()}
        feasibility[wrap] = Feasibility(**limit) if limit else None
    # Earlier fits lack the accuracy of the classifier alone.
    kinds = [field.name for field in fields(WrapQuality)]
    return WrapFit(
        wraps_of={muscle: tuple(wraps) for muscle, wraps in wraps_of.items()},
        translations={wrap: float(entry["translation_m"]) for wrap, entry in content.items()},
        # Earlier fits are of cylinders.
        classes={wrap: entry.get("surface", CYLINDER) for wrap, entry in content.items()},
        touched=tuple(wrap for wrap, entry in content.items() if entry["touched"]),
        inner=inner,
        feasibility=feasibility,
        quality={
            wrap: WrapQuality(**{kind: entry[kind] for kind in kinds if kind in entry})
            for wrap, entry in content.items()
        },
        thresholds=PhysiologicalThresholds(**thresholds),
    )


# Step of the frames with exact paths: discontinuities extend over several frames.
_EXACT_EVERY = 4


def polynomial_freedom(
    method: str, subject: Subject, surrogate: PathSurrogate, touching: tuple[str, ...]
) -> Freedom:
    """Build the freedom of a method with polynomial paths.

    NGA holds the paths, SGA frees the coefficients of all paths, and LSGA those of muscles that touch a wrap
    in a recorded frame.

    Parameters
    ----------
    method
        ``NGA``, ``SGA`` or ``LSGA``.
    subject
        Subject with its muscles.
    surrogate
        Polynomials of at least these muscles.
    touching
        Names of the muscles that touch a wrap.

    Raises
    ------
    InputError
        If LSGA has nothing to free.
    """
    freedom = nga_freedom(model_parameters(subject))
    if method == "NGA":
        return freedom
    free = _existing_modes(subject, surrogate)
    if method == "LSGA":
        free &= np.array([name in touching for name in subject.muscles.names])[:, None]
        if not free.any():
            raise InputError(
                Problem(
                    str(subject.model_file),
                    "no driven muscle touches a wrapping surface in the recorded cycles: LSGA frees nothing",
                    hint="use NGA or SGA",
                )
            )
    return with_paths(freedom, method, free, prior_sd=PATH_CHANGE)


def polynomial_paths(
    subject: Subject, trials: Trials, surrogate: PathSurrogate, freedom: Freedom
) -> AdjustablePath:
    """Evaluate polynomial paths over cycles, with path modes (`path_modes`) where the freedom frees them."""
    modes = None if freedom.paths is None else subject_path_modes(subject, surrogate)
    return surrogate_paths(surrogate, subject, trials, modes)


def subject_path_modes(subject: Subject, surrogate: PathSurrogate) -> Float[np.ndarray, "muscle term mode"]:
    """Compute the path modes of the subject's muscles over its calibration cycles (see `path_modes`)."""
    trials = subject.trials.used_for("calibration")
    used = np.asarray(surrogate.select_muscles(subject.muscles.names).used)
    muscles, terms = used.shape
    single = np.broadcast_to(np.eye(terms), (muscles, terms, terms))
    path = surrogate_paths(surrogate, subject, trials, single)
    return path_modes(path.nominal, path.modes, used, trials.moment_coordinates)


def _existing_modes(subject: Subject, surrogate: PathSurrogate) -> Bool[np.ndarray, "muscle mode"]:
    """Mark the modes that each muscle has: the first ones, as many as it has coefficients."""
    used = np.asarray(surrogate.select_muscles(subject.muscles.names).used)
    return np.arange(used.shape[1])[None] < used.sum(axis=1)[:, None]


def wrapped_polynomial_paths(
    subject: Subject, trials: Trials, surrogate: PathSurrogate, wraps: WrapFit, freed: FreedWraps
) -> ProximityPaths:
    """Evaluate polynomial paths over cycles, with coefficients that depend on the freed wrap parameters.

    Their proximity to discontinuities is that of the exact paths.
    """
    engine = build_engine(subject)
    angles, velocities = recorded_motion(trials, engine.coordinates)
    exact, _ = wrapped_paths(
        engine,
        angles[:, :, ::_EXACT_EVERY],
        velocities[:, :, ::_EXACT_EVERY],
        trials.moment_coordinates,
        freed.names,
        barrier_angles=angles_of_other_trials(subject, trials, engine.coordinates)[:, :, ::_EXACT_EVERY],
    )
    return with_exact_proximity(_two_level(subject, trials, surrogate, wraps, freed), exact, _EXACT_EVERY)


def calibrated_polynomials(
    subject: Subject,
    surrogate: PathSurrogate,
    wraps: WrapFit | None,
    freedom: Freedom,
    parameters: ModelParameters,
) -> PathSurrogate:
    """Compute the polynomials of the subject's muscles with calibrated coefficients.

    Parameters
    ----------
    subject
        Subject with its muscles.
    surrogate
        Polynomials before calibration.
    wraps
        Dependence of the coefficients on wrap parameters; None where it was not sampled.
    freedom
        Freedom of the calibration; held paths are unchanged.
    parameters
        Calibrated parameters.
    """
    own = surrogate.select_muscles(subject.muscles.names)
    changes = parameters.path_changes
    coefficients = own.coefficients
    if freedom.paths is not None:
        coefficients = coefficients + jnp.einsum(
            "mtk,mk->mt", subject_path_modes(subject, surrogate), changes
        )
    elif freedom.wraps is not None and wraps is not None:
        # The inner level: coefficients follow from the changes of wrap parameters.
        moving = np.flatnonzero((freedom.wraps.places >= 0).any(axis=1))
        inner = wraps.inner_of([own.muscles[row] for row in moving], freedom.wraps.places.shape[1])
        coefficients = coefficients.at[moving].add(inner(changes[moving]))
    return replace(own, coefficients=coefficients)


def _two_level(
    subject: Subject, trials: Trials, surrogate: PathSurrogate, wraps: WrapFit, freed: FreedWraps
) -> TwoLevelPaths:
    muscles = subject.muscles.names
    nominal = surrogate_paths(surrogate, subject, trials).nominal
    moving = np.flatnonzero((freed.places >= 0).any(axis=1))
    names = [muscles[row] for row in moving]
    return two_level_paths(
        nominal,
        moving.tolist(),
        wraps.inner_of(names, freed.places.shape[1]),
        coefficient_paths(surrogate, names, trials),
        wraps.limits(muscles, freed.names),
    )


def path_modes(
    nominal: PathState,
    by_coefficient: PathState,
    used: Bool[np.ndarray, "muscle term"],
    coordinates: Sequence[str],
) -> Float[np.ndarray, "muscle term mode"]:
    """Compute the modes of each path: principal axes of the penalty on changes of its coefficients.

    After Meyer et al. 2017 (doi:10.1371/journal.pone.0179698), changes of lengths and moment arms are
    penalized in their mean and in their shape, relative to the nominal range over the recorded cycles. The
    penalties are squares of functions that are linear in the coefficients, and thus one quadratic form for
    each muscle. Modes are its principal axes, each scaled to a penalty of one. The penalty of any change is
    then the squared norm of its vector of modes, and the problem is well conditioned.

    Parameters
    ----------
    nominal
        Paths of all muscles over the calibration cycles.
    by_coefficient
        Change of the paths per unit (1 m) of each coefficient; the first axes of all leaves are ``muscle
        term``.
    used
        Coefficients that a muscle has.
    coordinates
        Names of the coordinates of the moment arms.

    Returns
    -------
    Array
        Coefficients of each mode, m. Modes that a muscle does not have come last and are zero.
    """
    muscles, terms = used.shape
    length_range, arm_range = _range(nominal.length[:, :, None]), _range(nominal.moment_arm)
    distal = np.array([not name.startswith("hip") for name in coordinates])
    arm_shape = np.where(distal, _DISTAL_ARM_SHAPE, _ARM_SHAPE)[None]
    length, arm = np.asarray(by_coefficient.length)[:, :, :, None], np.asarray(by_coefficient.moment_arm)
    form = (
        _mean_square_of_mean(length, _LENGTH_MEAN * length_range)
        + _mean_square_of_shape(length, _LENGTH_SHAPE * length_range)
        + _mean_square_of_mean(arm, _ARM_MEAN * arm_range)
        + _mean_square_of_shape(arm, arm_shape * arm_range)
        + np.eye(terms) / _COEFFICIENT**2
    )
    modes = np.zeros((muscles, terms, terms))
    for muscle in range(muscles):
        columns = np.flatnonzero(used[muscle])
        values, axes = np.linalg.eigh(form[muscle][np.ix_(columns, columns)])
        modes[muscle, columns, : len(columns)] = axes / np.sqrt(values)
    return modes


def _range(values: Float[Array, "muscle trial coordinate frame"]) -> Float[np.ndarray, "muscle coordinate"]:
    return np.maximum(np.ptp(np.asarray(values), axis=(1, 3)), _LEAST_RANGE)


def _mean_square_of_mean(
    by: Float[np.ndarray, "muscle term trial coordinate frame"],
    allowable: Float[np.ndarray, "muscle coordinate"],
) -> Float[np.ndarray, "muscle term term"]:
    """Compute the quadratic form of the squared mean over frames, summed over coordinates."""
    mean = by.mean(axis=(2, 4)) / allowable[:, None]
    return np.einsum("mkc,mlc->mkl", mean, mean)


def _mean_square_of_shape(
    by: Float[np.ndarray, "muscle term trial coordinate frame"],
    allowable: Float[np.ndarray, "muscle coordinate"],
) -> Float[np.ndarray, "muscle term term"]:
    """Compute the quadratic form of the variance over frames, summed over coordinates."""
    frames = by.shape[2] * by.shape[4]
    shape = (by - by.mean(axis=(2, 4), keepdims=True)) / allowable[:, None, None, :, None]
    flat = shape.reshape(*by.shape[:2], -1)
    return flat @ np.swapaxes(flat, 1, 2) / frames
