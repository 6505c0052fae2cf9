"""``fit``: replace a subject's muscle paths by polynomials."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from wrapjax.api.polynomial_paths import polynomial_freedom, polynomial_paths
from wrapjax.errors import InputError, Problem
from wrapjax.files import cache_folder, content_hash, new_folder, write_json, write_whole
from wrapjax.geometry import AdjustablePath, PathSurrogate, fit_surrogate, random_poses, smooth_poses
from wrapjax.model import Freedom
from wrapjax.osim import (
    PathGeometry,
    analyse_muscles,
    describe_model,
    spanned_coordinates,
    touching_muscles,
)
from wrapjax.precision import require_float64
from wrapjax.progress import say
from wrapjax.subject import Subject, Trials

#: Poses for training: random ones in the walking belt, beside the frames of one smooth cycle.
TRAINING_POSES = 400
#: Poses that fitting never sees.
VALIDATION_POSES = 500
# Raise when the same subject and seed would give another fit.
_FORMAT = 3


@dataclass(frozen=True)
class PathError:
    """Errors of one muscle's path on poses never used in fitting, pooled over coordinates."""

    wrapped: bool
    length_rmse_mm: float
    length_max_mm: float
    moment_arm_rmse_mm: float
    moment_arm_max_mm: float
    terms: int


@dataclass(frozen=True)
class Fit:
    """A subject's muscle paths as polynomials, with their errors.

    Parameters
    ----------
    key
        Hash of what the fit was made from; a fit serves only the subject it was made for.
    surrogate
        The polynomials.
    errors
        By muscle.
    touching
        The muscles that lie on a wrapping surface in at least one recorded frame.
    seconds
        What took how long.
    """

    key: str
    surrogate: PathSurrogate
    errors: dict[str, PathError]
    touching: tuple[str, ...]
    seconds: dict[str, float]

    def freedom(self, method: str, subject: Subject) -> Freedom:
        """Say what a method frees: nothing of the paths (NGA), or their coefficients (SGA, LSGA)."""
        if method == "PGA":
            raise InputError(
                Problem(
                    str(subject.folder),
                    "PGA moves cylinders, and these polynomials do not know them",
                    hint="use --geometry engine",
                )
            )
        return polynomial_freedom(method, subject, self.surrogate, self.touching)

    def paths(self, subject: Subject, trials: Trials, freedom: Freedom) -> AdjustablePath:
        """Evaluate the paths over cycles, with all that the freedom may change."""
        return polynomial_paths(subject, trials, self.surrogate, freedom)

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``fit.json`` and ``fit.npz`` into a new folder."""
        with new_folder(Path(folder), force=force) as temporary:
            self._write(temporary)

    def _write(self, folder: Path) -> None:
        names = {"muscles": self.surrogate.muscles, "coordinates": self.surrogate.coordinates}
        arrays = _arrays(self.surrogate) | {name: np.array(value) for name, value in names.items()}

        def write(path: Path) -> None:
            np.savez(path, allow_pickle=False, **arrays)

        write_whole(folder / "fit.npz", write)
        content = {
            "schema": 1,
            "key": self.key,
            "seconds": self.seconds,
            "muscles": {name: vars(error) for name, error in self.errors.items()},
            "touching": list(self.touching),
            "wraps": {},
        }
        write_json(folder / "fit.json", content)


def fit(
    subject: Subject,
    geometry: str = "opensim",
    *,
    seed: int = 0,
    processes: int | None = None,
    quiet: bool = True,
) -> Fit:
    """Fit polynomials to length and moment arms of every driven muscle.

    Poses are 400 random ones in the belt that the recorded cycles sweep, frame by frame, and the 100
    of the fastest cycle; errors are measured on 500 other random ones.

    Parameters
    ----------
    subject
        From `load_subject`.
    geometry
        Where lengths and moment arms come from; ``opensim`` is its muscle analysis.
    seed
        Of the random poses.
    processes
        Worker processes for OpenSim; by default one a core.
    quiet
        Print no progress.

    Returns
    -------
    Fit
        Also kept in the user's cache: the same question is answered at once.
    """
    require_float64()
    if geometry != "opensim":
        raise ValueError(f"unknown geometry '{geometry}': expected 'opensim'")
    key = _key(subject, geometry, seed)
    cached = cache_folder("fit") / key
    if (cached / "fit.json").exists():
        try:
            return _read(cached)
        except (InputError, OSError, ValueError, KeyError):
            say(f"the cached fit in {cached} cannot be read and is made again", quiet=quiet)
    result = _fit(subject, key, seed, processes, quiet)
    result.save(cached, force=True)
    return result


def load_fit(folder: str | Path, subject: Subject | None = None) -> Fit:
    """Read a fit that `Fit.save` wrote.

    Parameters
    ----------
    folder
        Where it is.
    subject
        If given, a fit that does not cover its muscles and coordinates, or is of another model, is refused.
    """
    found = _read(Path(folder))
    if subject is not None:
        own = subject.muscles.names
        missing = [name for name in own if name not in found.surrogate.muscles]
        if missing or found.key.split("-")[0] != content_hash(subject.model_file):
            reason = f"it lacks muscle '{missing[0]}'" if missing else "it was made from another model file"
            raise InputError(
                Problem(
                    str(folder),
                    f"is no fit of subject '{subject.name}': {reason}",
                    hint="make it anew with 'wrapjax fit'",
                )
            )
    return found


def _key(subject: Subject, geometry: str, seed: int) -> str:
    trials = subject.trials
    question = content_hash(
        repr(subject.muscles.names),
        repr(trials.coordinates),
        trials.angles,
        trials.time,
        geometry,
        seed,
        _FORMAT,
    )
    return f"{content_hash(subject.model_file)}-{question}"


def _fit(subject: Subject, key: str, seed: int, processes: int | None, quiet: bool) -> Fit:
    trials = subject.trials
    muscles = subject.muscles.names
    spans = spanned_coordinates(subject.model_file, muscles)
    # Coordinates that were not recorded stay at the model's defaults.
    coordinates = tuple(name for name in trials.coordinates if any(name in spans[one] for one in muscles))
    angles = trials.angles[:, [trials.coordinates.index(name) for name in coordinates]]
    generator = np.random.default_rng(seed)
    training = np.concatenate(
        [
            random_poses(angles, TRAINING_POSES, generator),
            smooth_poses(angles, trials.time[:, -1] - trials.time[:, 0]),
        ]
    )
    validation = random_poses(angles, VALIDATION_POSES, generator)
    started = time.perf_counter()
    poses = np.concatenate([training, validation])
    analysed = analyse_muscles(
        subject.model_file, muscles, coordinates, poses, processes=processes, quiet=quiet
    )
    analysed_at = time.perf_counter()
    count = len(training)
    surrogate = fit_surrogate(
        muscles, coordinates, spans, training, analysed.length[:count], analysed.moment_arm[:count]
    )
    fitted_at = time.perf_counter()
    recorded = np.moveaxis(angles, 1, 2).reshape(-1, len(coordinates))
    touching = touching_muscles(subject.model_file, muscles, coordinates, recorded)
    touched_at = time.perf_counter()
    wrapped = {muscle.name: bool(muscle.wraps) for muscle in describe_model(subject.model_file).muscles}
    return Fit(
        key=key,
        surrogate=surrogate,
        errors=path_errors(surrogate, validation, analysed, slice(count, None), wrapped),
        touching=touching,
        seconds={
            "analysis": analysed_at - started,
            "fit": fitted_at - analysed_at,
            "contact": touched_at - fitted_at,
        },
    )


def path_errors(
    surrogate: PathSurrogate,
    poses: np.ndarray,
    truth: PathGeometry,
    rows: slice,
    wrapped: dict[str, bool],
) -> dict[str, PathError]:
    """Compare a surrogate with analysed paths, muscle by muscle.

    Moment-arm errors are pooled over the poses and the coordinates that the muscle spans.
    """
    grid = jnp.asarray(poses.T[None])
    path = surrogate(grid, jnp.zeros_like(grid))
    length_error = 1e3 * (np.asarray(path.length)[:, 0] - truth.length[rows].T)
    arm_error = 1e3 * (np.asarray(path.moment_arm)[:, 0] - np.transpose(truth.moment_arm[rows], (2, 1, 0)))
    errors = {}
    for index, muscle in enumerate(surrogate.muscles):
        slots = np.asarray(surrogate.spans[index])[np.asarray(surrogate.spanned[index])]
        arms = arm_error[index, slots]
        errors[muscle] = PathError(
            wrapped=wrapped[muscle],
            length_rmse_mm=_root_mean_square(length_error[index]),
            length_max_mm=float(np.abs(length_error[index]).max()),
            moment_arm_rmse_mm=_root_mean_square(arms),
            moment_arm_max_mm=float(np.abs(arms).max(initial=0.0)),
            terms=int(np.asarray(surrogate.used[index]).sum()),
        )
    return errors


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _arrays(surrogate: PathSurrogate) -> dict[str, np.ndarray]:
    return {name: np.asarray(value) for name, value in vars(surrogate).items() if eqx.is_array(value)}


def _read(folder: Path) -> Fit:
    json_file, array_file = folder / "fit.json", folder / "fit.npz"
    for file in (json_file, array_file):
        if not file.is_file():
            raise InputError(Problem(str(folder), f"is no FIT folder: {file.name} is missing"))
    try:
        content = json.loads(json_file.read_text(encoding="utf-8"))
        with np.load(array_file, allow_pickle=False) as stored:
            arrays = dict(stored)
        muscles, coordinates = (tuple(arrays.pop(key).tolist()) for key in ("muscles", "coordinates"))
        surrogate = PathSurrogate(
            muscles, coordinates, **{name: jnp.asarray(value) for name, value in arrays.items()}
        )
        errors = {name: PathError(**entry) for name, entry in content["muscles"].items()}
        return Fit(content["key"], surrogate, errors, tuple(content["touching"]), content["seconds"])
    except (ValueError, KeyError, TypeError, EOFError) as error:
        raise InputError(
            Problem(str(folder), f"is damaged ({error})", hint="make it anew with 'wrapjax fit'")
        ) from error
