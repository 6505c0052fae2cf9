"""What a fit knows of cylinders: how paths follow them, and where they leave paths physiological.

Paths of one source, guarded by the exact engine: from where true paths would jump, and from straying.

Polynomials as a source of paths: what each method frees of them, and how they run through the cycles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.feasibility import MIN_CLASS_SHARE, Feasibility
from wrapjax.geometry.path_modes import PATH_CHANGE, path_modes
from wrapjax.geometry.paths import AbstractPath, AdjustablePath, PathState
from wrapjax.geometry.physiological import PhysiologicalThresholds
from wrapjax.geometry.surrogate import PathSurrogate
from wrapjax.geometry.two_level import InnerLevel, TwoLevelPaths, two_level_paths
from wrapjax.geometry.wrapped_paths import WrappedPaths, wrapped_paths
from wrapjax.model.freedom import Freedom, FreedWraps, nga_freedom, with_paths
from wrapjax.model.parameters import ModelParameters
from wrapjax.path_sources.exact import angles_of_other_trials, build_engine, freed_wraps, recorded_motion
from wrapjax.path_sources.model_inputs import coefficient_paths, model_parameters, surrogate_paths
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials


@dataclass(frozen=True)
class WrapQuality:
    """How one cylinder's samples fared, on samples and poses never used in fitting.

    Parameters
    ----------
    physiological_share
        Of its box.
    balanced_accuracy, false_physiological
        Of its learned limit and the exact margins together, as PGA has both; see
        `wrapjax.geometry.FeasibilityQuality`. The margins are asked in recorded poses, the truth in others.
    learned_balanced_accuracy, learned_false_physiological
        Of the learned limit alone.
    """

    physiological_share: float
    balanced_accuracy: float | None
    false_physiological: float | None
    learned_balanced_accuracy: float | None = None
    learned_false_physiological: float | None = None


@dataclass(frozen=True)
class WrapFit:
    """The inner level of a subject's surrogate, and the limits of its cylinders.

    Parameters
    ----------
    wraps_of
        The cylinders of each muscle, in the order of its path.
    translations
        Half width of each cylinder's box along its axes, m.
    touched
        The cylinders that some muscle lies on in at least one recorded frame.
    inner
        Of all muscles, in the order of ``wraps_of``.
    feasibility
        By cylinder; None where too few samples are of either kind to learn from.
    quality
        By cylinder.
    thresholds
        What counted as physiological.
    """

    wraps_of: dict[str, tuple[str, ...]]
    translations: dict[str, float]
    touched: tuple[str, ...]
    inner: InnerLevel
    feasibility: dict[str, Feasibility | None]
    quality: dict[str, WrapQuality]
    thresholds: PhysiologicalThresholds

    def movable(self, surfaces: str) -> tuple[str, ...]:
        """Name cylinders (of `SURFACES`), but for those whose box is not physiological almost anywhere."""
        among = self.touched if surfaces == "touched" else tuple(self.quality)
        return tuple(name for name in among if self.quality[name].physiological_share >= MIN_CLASS_SHARE)

    def freed(self, muscles: Sequence[str], surfaces: str = "touched") -> FreedWraps:
        """Free the movable cylinders of these muscles."""
        own = {wrap for name in muscles for wrap in self.wraps_of[name]}
        translations = {name: self.translations[name] for name in self.movable(surfaces) if name in own}
        return freed_wraps([self.wraps_of[name] for name in muscles], translations)

    def inner_of(self, muscles: Sequence[str], wraps: int) -> InnerLevel:
        """Pick muscles by name, in this order, and as many places for cylinders."""
        rows = np.array([list(self.wraps_of).index(name) for name in muscles])
        return InnerLevel(self.inner.weights[rows, :wraps], self.inner.half_range[rows, :wraps])

    def limits(self, muscles: Sequence[str], wraps: Sequence[str]) -> list[tuple[int, int, Feasibility]]:
        """Say which muscle, at which of its places, each limited cylinder can be read off."""
        found = []
        for wrap in wraps:
            feasibility = self.feasibility[wrap]
            row = next(row for row, name in enumerate(muscles) if wrap in self.wraps_of[name])
            if feasibility is not None:
                found.append((row, self.wraps_of[muscles[row]].index(wrap), feasibility))
        return found

    def arrays(self) -> dict[str, np.ndarray]:
        """Give all arrays by name, for `from_arrays`."""
        stored = {f"inner.{name}": value for name, value in vars(self.inner).items()}
        for wrap, feasibility in self.feasibility.items():
            if feasibility is not None:
                stored |= {f"feasibility.{wrap}.{name}": value for name, value in vars(feasibility).items()}
        return {name: np.asarray(value) for name, value in stored.items() if eqx.is_array_like(value)}

    def content(self) -> dict[str, dict]:
        """Describe each cylinder in plain values."""
        return {
            name: {
                **vars(quality),
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
    """Put together what `WrapFit.arrays` and `WrapFit.content` took apart."""
    names = ("weights", "half_range")
    inner = InnerLevel(**{name: jnp.asarray(arrays[f"inner.{name}"]) for name in names})
    feasibility: dict[str, Feasibility | None] = {}
    for wrap in content:
        prefix = f"feasibility.{wrap}."
        own = {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
        limit = {name: jnp.asarray(value) for name, value in own.items()}
        feasibility[wrap] = Feasibility(**limit) if limit else None
    # Fits made before the learned limit was judged alone do not say how well it does.
    kinds = [field.name for field in fields(WrapQuality)]
    return WrapFit(
        wraps_of={muscle: tuple(wraps) for muscle, wraps in wraps_of.items()},
        translations={wrap: float(entry["translation_m"]) for wrap, entry in content.items()},
        touched=tuple(wrap for wrap, entry in content.items() if entry["touched"]),
        inner=inner,
        feasibility=feasibility,
        quality={
            wrap: WrapQuality(**{kind: entry[kind] for kind in kinds if kind in entry})
            for wrap, entry in content.items()
        },
        thresholds=PhysiologicalThresholds(**thresholds),
    )


#: Differences from the exact length and moment arm (m), beyond those of nominal paths, at which closeness
#: is one.
LENGTH_DEVIATION, ARM_DEVIATION = 1.5e-4, 4e-4
# Keeps the root's slope finite for paths that no wall is near to.
_TINY = 1e-24


class ProximityPaths(AbstractPath):
    """Paths that are told by the exact ones how close they are to what they must not get to.

    Polynomials follow cylinders smoothly to where no real path would follow: a path point inside, the
    cylinder's end, a cylinder lost. And in a corner of what they were learned from they can be wrong by a
    millimeter. The exact paths know, and need only be asked in some frames.
    """

    nominal: PathState
    #: Where lengths and moment arms come from.
    paths: AbstractPath
    #: In every so many frames of the same cycles, with the same changes.
    exact: WrappedPaths
    every: int = eqx.field(static=True)

    @property
    def modes_count(self) -> int:
        """How many changes a muscle has at most."""
        return self.paths.modes_count

    @property
    def resolution(self) -> float:
        """That of the exact paths' kinks."""
        return self.exact.resolution

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Give all paths, changed by these amounts."""
        return self._guarded(self.paths.at(changes), self.exact.at(changes))

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Give all paths, and how each moves with its own changes (leaves lead with ``muscle mode``)."""
        at = self.paths.linearized(changes), self.exact.linearized(changes)
        (state, slopes), (exact, exact_slopes) = at

        def along(slope: PathState, exact_slope: PathState) -> tuple[PathState, PathState]:
            return jax.jvp(self._guarded, (state, exact), (slope, exact_slope))

        return jax.vmap(along, in_axes=1, out_axes=(None, 1))(slopes, exact_slopes)

    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Differentiate the paths twice, the closeness included.

        It is a root of a sum of squares: what a solver of least squares makes of its slopes alone is one
        direction of many, and without the rest its steps are short wherever paths are held.
        """
        (state, slopes), (exact, exact_slopes) = (
            self.paths.linearized(changes),
            self.exact.linearized(changes),
        )

        def by_paths(state: PathState, exact: PathState) -> tuple[PathState, PathState]:
            def total(state: PathState, exact: PathState) -> Float[Array, ""]:
                proximity = self._guarded(state, exact).proximity
                assert proximity is not None and weights.proximity is not None, "guarded paths have it"
                return jnp.vdot(weights.proximity, proximity)

            return jax.grad(total, argnums=(0, 1))(state, exact)

        def along(*slope: PathState) -> tuple[PathState, PathState]:
            return jax.jvp(by_paths, (state, exact), slope)[1]

        bent = jax.vmap(along, in_axes=1, out_axes=1)(slopes, exact_slopes)
        products = jax.tree.map(
            lambda one, other: jnp.einsum("mi...,mj...->mij", one, other), bent, (slopes, exact_slopes)
        )
        of_guard = jax.tree.reduce(jnp.add, products)
        by_state, by_exact = by_paths(state, exact)
        of_state = jax.tree.map(jnp.add, replace(weights, proximity=None), by_state)
        of_paths = self.paths.curvature(changes, of_state, (state, slopes))
        return of_guard + of_paths + self.exact.curvature(changes, by_exact, (exact, exact_slopes))

    def _guarded(self, state: PathState, exact: PathState) -> PathState:
        """Add the closeness; it is held from one frame in which it is known to the next."""
        assert exact.proximity is not None, "the engine's paths know it"
        length, arm = (
            (own - usual)[..., :: self.every] - (true - usually_true)
            for own, usual, true, usually_true in (
                (state.length, self.nominal.length, exact.length, self.exact.nominal.length),
                (state.moment_arm, self.nominal.moment_arm, exact.moment_arm, self.exact.nominal.moment_arm),
            )
        )
        # Squares, and no higher powers: they are what a solver of least squares sees through.
        strayed = (length / LENGTH_DEVIATION) ** 2 + jnp.sum((arm / ARM_DEVIATION) ** 2, axis=-2)
        within = jnp.isfinite(exact.proximity)
        # Beyond a wall nothing has a slope.
        to_wall = jnp.where(within, exact.proximity, 0.0)
        proximity = jnp.where(within, jnp.sqrt(to_wall**2 + strayed + _TINY), jnp.inf)
        frames = state.length.shape[-1]
        return replace(state, proximity=jnp.repeat(proximity, self.every, axis=-1)[..., :frames])


def with_exact_proximity(paths: AbstractPath, exact: WrappedPaths, every: int) -> ProximityPaths:
    """Guard paths over cycles by exact ones over every so many frames of them, from the first on."""
    unguarded = ProximityPaths(paths.nominal, paths, exact, every)
    return replace(unguarded, nominal=unguarded._guarded(paths.nominal, exact.nominal))


# Frames in which the engine guards polynomials: paths come to jump over several of them.
_GUARDED_EVERY = 4


def polynomial_freedom(
    method: str, subject: Subject, surrogate: PathSurrogate, touching: tuple[str, ...]
) -> Freedom:
    """Say what a method frees for a subject.

    NGA: nothing of the geometry. SGA: also all coefficients of all paths. LSGA: those of the muscles
    that lie on a wrapping surface in at least one recorded frame.
    """
    freedom = nga_freedom(model_parameters(subject))
    if method == "NGA":
        return freedom
    free = _own_modes(subject, surrogate)
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
    """Evaluate the paths over cycles; where they are free they have their modes (see `path_modes`)."""
    modes = None if freedom.paths is None else subject_path_modes(subject, surrogate)
    return surrogate_paths(surrogate, subject, trials, modes)


def subject_path_modes(subject: Subject, surrogate: PathSurrogate) -> Float[np.ndarray, "muscle term mode"]:
    """Find the modes of the subject's paths over its calibration cycles (see `path_modes`)."""
    trials = subject.trials.used_for("calibration")
    used = np.asarray(surrogate.select_muscles(subject.muscles.names).used)
    muscles, terms = used.shape
    single = np.broadcast_to(np.eye(terms), (muscles, terms, terms))
    path = surrogate_paths(surrogate, subject, trials, single)
    return path_modes(path.nominal, path.modes, used, trials.moment_coordinates)


def _own_modes(subject: Subject, surrogate: PathSurrogate) -> Bool[np.ndarray, "muscle mode"]:
    """Mark the modes that a muscle has: as many as it has coefficients, the first ones."""
    used = np.asarray(surrogate.select_muscles(subject.muscles.names).used)
    return np.arange(used.shape[1])[None] < used.sum(axis=1)[:, None]


def wrapped_polynomial_paths(
    subject: Subject, trials: Trials, surrogate: PathSurrogate, wraps: WrapFit, freed: FreedWraps
) -> ProximityPaths:
    """Evaluate the paths over cycles, with coefficients that follow the freed cylinders.

    The exact engine guards them where they would jump.
    """
    engine = build_engine(subject)
    angles, velocities = recorded_motion(trials, engine.coordinates)
    exact, _ = wrapped_paths(
        engine,
        angles[:, :, ::_GUARDED_EVERY],
        velocities[:, :, ::_GUARDED_EVERY],
        trials.moment_coordinates,
        freed.names,
        barrier_angles=angles_of_other_trials(subject, trials, engine.coordinates)[:, :, ::_GUARDED_EVERY],
    )
    return with_exact_proximity(_two_level(subject, trials, surrogate, wraps, freed), exact, _GUARDED_EVERY)


def calibrated_polynomials(
    subject: Subject,
    surrogate: PathSurrogate,
    wraps: WrapFit | None,
    freedom: Freedom,
    parameters: ModelParameters,
) -> PathSurrogate:
    """Give the subject's polynomials with coefficients as a calibration left them.

    Parameters
    ----------
    subject, surrogate, wraps
        Whose paths, and how they follow cylinders, where that was sampled.
    freedom, parameters
        What was free, and what came of it. Where paths were held they stay as they are.
    """
    own = surrogate.select_muscles(subject.muscles.names)
    changes = parameters.path_changes
    coefficients = own.coefficients
    if freedom.paths is not None:
        coefficients = coefficients + jnp.einsum(
            "mtk,mk->mt", subject_path_modes(subject, surrogate), changes
        )
    elif freedom.wraps is not None and wraps is not None:
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
