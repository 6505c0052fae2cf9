"""The exact path engine as the source of a subject's muscle paths, and the wraps that PGA frees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.exact_paths.engine import GEODESIC, PARITY, ExactPaths, Wrapping
from wrapjax.geometry.exact_paths.wrapped_paths import wrapped_paths
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS, WRAP_PARAMETERS
from wrapjax.geometry.paths import AbstractPath, fixed_path
from wrapjax.geometry.surrogates.physiological import DEFAULT_THRESHOLDS
from wrapjax.geometry.surrogates.wrap_bounds import CYLINDER, parameter_box, translation_bounds
from wrapjax.io.files import content_hash
from wrapjax.jax_setup import require_float64
from wrapjax.model.freedom import Freedom, FreedWraps, nga_freedom, with_wraps
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.model_inputs import model_parameters
from wrapjax.path_sources.near_bones import NearBones, find_near_bones
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

#: Wrapping algorithms of the exact engine, by the names of the option ``--geometry``.
WRAPPINGS: dict[str, Wrapping] = {"engine": GEODESIC, "engine-parity": PARITY}
# Step of the recorded frames in which bounds on translations are determined.
_FRAME_STEP = 4
#: Choices of the wraps that PGA frees: those that some muscle touches in a recorded frame, or all.
SURFACES = ("touched", "all")
#: Error messages by this choice where there is no such wrap.
NO_WRAPS_TO_FREE = {
    "touched": "no driven muscle touches a wrapping surface in the recorded cycles: PGA frees nothing",
    "all": "no driven muscle has a wrapping surface that could be moved: PGA frees nothing",
}
# Prior standard deviation in half widths of the bounds: wide, because the bounds limit the parameters.
_PRIOR_WIDTH = 2.0


@dataclass(frozen=True)
class ExactGeometry:
    """A subject's muscle paths from the exact engine.

    Parameters
    ----------
    name
        Wrapping algorithm, of `WRAPPINGS`: ``engine`` or ``engine-parity``.
    key
        Hash of everything that determines the paths.
    engine
        Engine with the subject's muscles and recorded coordinates.
    on_surface
        Whether each muscle touches each of its wraps in a recorded frame.
    translations
        Largest translation of each touched wrap along each axis, to either side, m.
    bones
        Bones near which freed wraps stay; None where none were given.
    """

    name: str
    key: str
    engine: ExactPaths
    on_surface: Bool[np.ndarray, "muscle wrap"]
    translations: dict[str, float]
    bones: NearBones | None = field(default=None, kw_only=True)

    @property
    def wrapping(self) -> Wrapping:
        """Wrapping algorithm: shortest path, or as in OpenSim."""
        return WRAPPINGS[self.name]

    @property
    def touching(self) -> tuple[str, ...]:
        """Names of the muscles that touch a wrap in a recorded frame."""
        return tuple(
            name for name, touched in zip(self.engine.muscles, self.on_surface, strict=True) if touched.any()
        )

    def freedom(self, method: str, subject: Subject, surfaces: str = "touched") -> Freedom:
        """Build the freedom of a method.

        Parameters
        ----------
        method
            ``NGA`` (paths held) or ``PGA`` (wraps freed).
        subject
            Subject of these paths.
        surfaces
            Wraps that PGA frees, one of `SURFACES`.

        Raises
        ------
        InputError
            If the method adjusts polynomials, or there is no wrap to free.
        """
        freedom = nga_freedom(model_parameters(subject))
        if method == "NGA":
            return freedom
        if method != "PGA":
            raise InputError(
                Problem(
                    str(subject.folder),
                    f"{method} changes polynomials, and the exact engine has none",
                    hint="use --geometry surrogate, or PGA",
                )
            )
        translations = self.translations if surfaces == "touched" else self._all_translations(subject)
        if not translations:
            raise InputError(
                Problem(
                    str(subject.model_file),
                    NO_WRAPS_TO_FREE[surfaces],
                    hint="use NGA or SGA",
                )
            )
        shares = self._shares_near_bones(translations)
        wraps_of = [self.engine.wraps_of(name) for name in self.engine.muscles]
        classes, names = self.engine.wrap_classes, self.engine.parameters
        near = {name: translations[name] for name in shares}
        return with_wraps(freedom, method, freed_wraps(wraps_of, near, classes, names, shares))

    def _shares_near_bones(self, translations: Mapping[str, float]) -> dict[str, float]:
        """Find by which factor to reduce the bounds of each wrap that can move and stay near its bones."""
        if self.bones is None:
            return dict.fromkeys(translations, 1.0)
        shares = {
            name: self.bones.box_share(self.engine.model.wrap(name), translation, self.engine.parameters)
            for name, translation in translations.items()
        }
        if not any(shares.values()):
            raise InputError(
                Problem(
                    ", ".join(map(str, self.bones.folders)),
                    "none of the surfaces that PGA would move stays within "
                    f"{1e3 * self.bones.distance:g} mm of its nominal distance from the bones",
                    hint="allow a larger distance, or use NGA",
                )
            )
        return {name: share for name, share in shares.items() if share > 0.0}

    def _all_translations(self, subject: Subject) -> dict[str, float]:
        """Determine the largest translation of each wrap, touched or not, m."""
        wraps = {wrap for name in self.engine.muscles for wrap in self.engine.wraps_of(name)}
        others = sorted(wraps - set(self.translations))
        found = translation_bounds(self.engine, self.engine.posed(_poses(self.engine, subject)), others)
        return dict(sorted((self.translations | found).items()))

    def paths(self, subject: Subject, trials: Trials, freedom: Freedom) -> AbstractPath:
        """Compute the paths over cycles as functions of what the freedom frees.

        With free wraps, the proximity of the paths also covers the subject's other cycles, so that a
        calibration avoids discontinuities in all of them.

        Parameters
        ----------
        subject
            Subject of these paths.
        trials
            Cycles over which to compute the paths.
        freedom
            Freedom of the calibration.
        """
        free = () if freedom.wraps is None else freedom.wraps.names
        paths, _ = wrapped_paths(
            self.engine,
            *recorded_motion(trials, self.engine.coordinates),
            trials.moment_coordinates,
            free,
            self.wrapping,
            angles_of_other_trials(subject, trials, self.engine.coordinates) if free else None,
        )
        return paths if free else fixed_path(paths.nominal)


def exact_geometry(
    subject: Subject,
    geometry: str = "engine",
    *,
    bone_folders: Sequence[Path] = (),
    bone_distance: float = DEFAULT_THRESHOLDS.bone_distance,
) -> ExactGeometry:
    """Build a subject's muscle paths with the exact engine.

    Parameters
    ----------
    subject
        Subject from `load_subject`.
    geometry
        Wrapping algorithm: ``engine`` computes shortest paths, ``engine-parity`` paths as in OpenSim 4.6.
    bone_folders
        Folders with the surfaces of bones (``.vtp``) that the model names. Where they are given, the bounds
        of wrap parameters are reduced so that wraps stay near the bones of their body. Bones without a file
        do not count.
    bone_distance
        Largest increase of a wrap's distance from the bones of its body over that of the nominal wrap, m.

    Returns
    -------
    ExactGeometry
        Paths, to be given to `calibrate` as ``fit``.

    Raises
    ------
    InputError
        If a muscle's path has an element that the engine does not support; or if folders of bones are given
        that have none of the model's wrapped bodies, or a damaged one.
    ValueError
        If the geometry is unknown.

    Examples
    --------
    >>> paths = exact_geometry(subject)  # doctest: +SKIP
    >>> calibrate(subject, "PGA", paths)  # doctest: +SKIP
    """
    require_float64()
    if geometry not in WRAPPINGS:
        raise ValueError(f"unknown geometry '{geometry}': expected one of {', '.join(WRAPPINGS)}")
    bones = find_near_bones(subject.model_file, bone_folders, bone_distance) if bone_folders else None
    engine = build_engine(subject)
    angles, _ = recorded_motion(subject.trials, engine.coordinates)
    touching, touched = touched_wraps(engine, subject.trials)
    return ExactGeometry(
        name=geometry,
        key="-".join(
            [
                content_hash(subject.model_file),
                content_hash(geometry, repr(engine.muscles), angles),
                *(() if bones is None else (content_hash(bones.distance, *bones.vertices.values()),)),
            ]
        ),
        engine=engine,
        on_surface=touching,
        translations=translation_bounds(engine, engine.posed(_poses(engine, subject)), touched),
        bones=bones,
    )


def _poses(engine: ExactPaths, subject: Subject) -> Float[np.ndarray, "pose coordinate"]:
    """Select the recorded poses in which bounds on translations are determined, rad or m."""
    angles, _ = recorded_motion(subject.trials, engine.coordinates)
    return np.moveaxis(angles, 1, -1).reshape(-1, len(engine.coordinates))[::_FRAME_STEP]


def touched_wraps(
    engine: ExactPaths, trials: Trials
) -> tuple[Bool[np.ndarray, "muscle wrap"], tuple[str, ...]]:
    """Determine the wraps that muscles touch.

    Returns
    -------
    touching, names
        Whether each muscle touches each of its wraps in at least one frame of the trials, and the sorted
        names of these wraps.
    """
    motion = recorded_motion(trials, engine.coordinates)
    _, touching = wrapped_paths(engine, *motion, trials.moment_coordinates, (), GEODESIC)
    names = {
        wrap
        for row, muscle in enumerate(engine.muscles)
        for place, wrap in enumerate(engine.wraps_of(muscle))
        if touching[row, place]
    }
    return touching, tuple(sorted(names))


def build_engine(subject: Subject) -> ExactPaths:
    """Build the exact engine for a subject's muscles and the recorded coordinates that they span."""
    model = describe_model(subject.model_file)
    spanned = {name for muscle in subject.muscles.names for name in model.spanned_by(muscle)}
    coordinates = tuple(name for name in subject.trials.coordinates if name in spanned)
    return ExactPaths(model, subject.muscles.names, coordinates)


def angles_of_other_trials(
    subject: Subject, trials: Trials, coordinates: tuple[str, ...]
) -> Float[np.ndarray, "other_trial coordinate frame"]:
    """Return the angles of coordinates in the subject's cycles that are not in ``trials``, rad or m."""
    others = np.flatnonzero([name not in trials.names for name in subject.trials.names])
    return recorded_motion(subject.trials.select(others), coordinates)[0]


def recorded_motion(
    trials: Trials, coordinates: tuple[str, ...]
) -> tuple[Float[np.ndarray, "trial coordinate frame"], Float[np.ndarray, "trial coordinate frame"]]:
    """Return the angles (rad or m) and angular velocities (rad/s or m/s) of coordinates in trials."""
    columns = [trials.coordinates.index(name) for name in coordinates]
    return trials.angles[:, columns], trials.angular_velocities[:, columns]


def freed_wraps(
    wraps_of: Sequence[Sequence[str]],
    translations: Mapping[str, float],
    classes: Mapping[str, str] | None = None,
    quantities: Sequence[str] = WRAP_PARAMETERS,
    shares: Mapping[str, float] | None = None,
) -> FreedWraps:
    """Free wraps within the bounds of their parameters (see `parameter_box`), with nominal prior means.

    Parameters
    ----------
    wraps_of
        Names of the wraps of each muscle, in the order of its path.
    translations
        Largest translation along each axis of each freed wrap, m.
    classes
        OpenSim's class of each wrap; by default all are cylinders.
    quantities
        Names of the wrap parameters.
    shares
        Factor, of 0 to 1, by which the bounds of each wrap are reduced towards the nominal values; by default
        they are not.

    Returns
    -------
    FreedWraps
        Freed wraps, in the order of ``translations``.
    """
    names = tuple(translations)
    places = np.full((len(wraps_of), max(map(len, wraps_of), default=0)), -1)
    for row, wraps in enumerate(wraps_of):
        for place, wrap in enumerate(wraps):
            if wrap in names:
                places[row, place] = names.index(wrap)
    boxes = [
        parameter_box(translations[name], CYLINDER if classes is None else classes[name], quantities)
        for name in names
    ]
    nominal = NOMINAL_PARAMETERS[: len(quantities)]
    factors = np.array([1.0 if shares is None else shares[name] for name in names])
    deviations = (np.reshape(boxes, (-1, 2, len(quantities))) - nominal) * factors[:, None, None]
    lower, upper = np.moveaxis(deviations, 1, 0)
    half_width = np.where(upper > lower, 0.5 * (upper - lower), 1.0)
    suffixes = (name.rpartition("_")[2] for name in quantities)
    return FreedWraps(
        names=names,
        quantities=tuple(quantities),
        units=tuple(suffix if suffix in ("m", "rad") else "1" for suffix in suffixes),
        places=places,
        lower=lower,
        upper=upper,
        scale=half_width,
        prior_sd=_PRIOR_WIDTH * half_width,
    )
