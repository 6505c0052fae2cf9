"""What calibrations may change of cylinders, whatever the source of the paths.

The exact engine as a source of paths: no training, and cylinders that can be moved (PGA).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.engine import GEODESIC, PARITY, ExactPaths, Wrapping
from wrapjax.geometry.paths import AbstractPath, fixed_path
from wrapjax.geometry.wrap_bounds import parameter_box, translation_bounds
from wrapjax.geometry.wrapped_paths import wrapped_paths
from wrapjax.geometry.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.io.files import content_hash
from wrapjax.jax_setup import require_float64
from wrapjax.model.freedom import Freedom, FreedWraps, nga_freedom, with_wraps
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.model_inputs import model_parameters
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

_UNITS = ("m", "m", "m", "rad", "rad", "1")
#: Which cylinders PGA frees: those that some muscle lies on in at least one recorded frame, or all.
SURFACES = ("touched", "all")
#: What is said where there are none.
NO_CYLINDER = {
    "touched": "no driven muscle touches a cylinder in the recorded cycles: PGA frees nothing",
    "all": "no driven muscle has a cylinder that could be moved: PGA frees nothing",
}
# Prior deviations, in half widths: the box says where cylinders can be, the prior only breaks ties.
_PRIOR = 2.0


def freed_wraps(wraps_of: Sequence[Sequence[str]], translations: Mapping[str, float]) -> FreedWraps:
    """Free cylinders within their boxes; what is expected is nominal, within a box's width.

    Parameters
    ----------
    wraps_of
        The cylinders of each muscle, in the order of its path.
    translations
        Half width of the box of each freed cylinder, m.
    """
    names = tuple(translations)
    places = np.full((len(wraps_of), max(map(len, wraps_of), default=0)), -1)
    for row, wraps in enumerate(wraps_of):
        for place, wrap in enumerate(wraps):
            if wrap in names:
                places[row, place] = names.index(wrap)
    boxes = np.reshape([parameter_box(translations[name]) for name in names], (-1, 2, len(NOMINAL)))
    lower, upper = boxes[:, 0] - NOMINAL, boxes[:, 1] - NOMINAL
    half = 0.5 * (upper - lower)
    return FreedWraps(
        names=names,
        quantities=WRAP_PARAMETERS,
        units=_UNITS,
        places=places,
        lower=lower,
        upper=upper,
        scale=half,
        prior_sd=_PRIOR * half,
    )


#: Ways in which the engine can wrap, by the names that commands know.
WRAPPINGS: dict[str, Wrapping] = {"engine": GEODESIC, "engine-parity": PARITY}
# Poses that bounds of translation are found in: every so many recorded frames.
_EVERY = 4


@dataclass(frozen=True)
class ExactGeometry:
    """A subject's muscle paths from the exact engine.

    Parameters
    ----------
    name
        ``engine`` or ``engine-parity``.
    key
        Hash of what decides the paths.
    engine
        Of the subject's muscles and recorded coordinates.
    on_surface
        Which of its cylinders each muscle lies on in at least one recorded frame.
    translations
        How far each touched cylinder may move along each axis, to either side (m).
    """

    name: str
    key: str
    engine: ExactPaths
    on_surface: Bool[np.ndarray, "muscle wrap"]
    translations: dict[str, float]

    @property
    def wrapping(self) -> Wrapping:
        """The shortest way, or OpenSim's."""
        return WRAPPINGS[self.name]

    @property
    def touching(self) -> tuple[str, ...]:
        """The muscles that lie on a wrapping surface in at least one recorded frame."""
        return tuple(
            name for name, touched in zip(self.engine.muscles, self.on_surface, strict=True) if touched.any()
        )

    def freedom(self, method: str, subject: Subject, surfaces: str = "touched") -> Freedom:
        """Say what a method frees: nothing of the paths (NGA), or the cylinders of `SURFACES` (PGA)."""
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
                    NO_CYLINDER[surfaces],
                    hint="use NGA or SGA",
                )
            )
        wraps_of = [self.engine.wraps_of(name) for name in self.engine.muscles]
        return with_wraps(freedom, method, freed_wraps(wraps_of, translations))

    def _all_translations(self, subject: Subject) -> dict[str, float]:
        """How far each cylinder may move, touched or not."""
        wraps = {wrap for name in self.engine.muscles for wrap in self.engine.wraps_of(name)}
        others = sorted(wraps - set(self.translations))
        found = translation_bounds(self.engine, self.engine.posed(_poses(self.engine, subject)), others)
        return dict(sorted((self.translations | found).items()))

    def paths(self, subject: Subject, trials: Trials, freedom: Freedom) -> AbstractPath:
        """Lay the paths through cycles, with all that the freedom may change.

        Where cylinders may move, paths get over no wall in the subject's other cycles either.
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


def exact_geometry(subject: Subject, geometry: str = "engine") -> ExactGeometry:
    """Take a subject's muscle paths from the exact engine.

    Parameters
    ----------
    subject
        From `load_subject`.
    geometry
        ``engine`` lays paths the shortest way; ``engine-parity`` as OpenSim 4.6 does.

    Raises
    ------
    InputError
        If a muscle's path has something that the engine does not know.
    """
    require_float64()
    if geometry not in WRAPPINGS:
        raise ValueError(f"unknown geometry '{geometry}': expected one of {', '.join(WRAPPINGS)}")
    engine = build_engine(subject)
    angles, _ = recorded_motion(subject.trials, engine.coordinates)
    touching, touched = touched_wraps(engine, subject.trials)
    return ExactGeometry(
        name=geometry,
        key=f"{content_hash(subject.model_file)}-{content_hash(geometry, repr(engine.muscles), angles)}",
        engine=engine,
        on_surface=touching,
        translations=translation_bounds(engine, engine.posed(_poses(engine, subject)), touched),
    )


def _poses(engine: ExactPaths, subject: Subject) -> Float[np.ndarray, "pose coordinate"]:
    """Take the recorded frames that boxes are found in."""
    angles, _ = recorded_motion(subject.trials, engine.coordinates)
    return np.moveaxis(angles, 1, -1).reshape(-1, len(engine.coordinates))[::_EVERY]


def touched_wraps(
    engine: ExactPaths, trials: Trials
) -> tuple[Bool[np.ndarray, "muscle wrap"], tuple[str, ...]]:
    """Say which of its cylinders each muscle lies on in at least one frame, and name these cylinders."""
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
    """Build the exact engine of a subject's muscles, over the recorded coordinates that they span."""
    model = describe_model(subject.model_file)
    spanned = {name for muscle in subject.muscles.names for name in model.spanned_by(muscle)}
    coordinates = tuple(name for name in subject.trials.coordinates if name in spanned)
    return ExactPaths(model, subject.muscles.names, coordinates)


def angles_of_other_trials(
    subject: Subject, trials: Trials, coordinates: tuple[str, ...]
) -> Float[np.ndarray, "other_trial coordinate frame"]:
    """Angles of the engine's coordinates in those of a subject's cycles that are not among these."""
    others = np.flatnonzero([name not in trials.names for name in subject.trials.names])
    return recorded_motion(subject.trials.select(others), coordinates)[0]


def recorded_motion(
    trials: Trials, coordinates: tuple[str, ...]
) -> tuple[Float[np.ndarray, "trial coordinate frame"], Float[np.ndarray, "trial coordinate frame"]]:
    """Angles and angular velocities of the engine's coordinates."""
    columns = [trials.coordinates.index(name) for name in coordinates]
    return trials.angles[:, columns], trials.angular_velocities[:, columns]
