"""Whether a project's own muscle geometry is that of its model, from which ours is calculated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError
from wrapjax.io.model_file import read_model_file
from wrapjax.io.storage import Storage, find_column, read_storage
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import PathGeometry, analyse_muscles
from wrapjax.preprocessing.nmsm_project import MuscleAnalysis, Project, Recorded, read_muscle_analyses
from wrapjax.subject.recordings import all_angles

#: Differences of lengths and of moment arms beyond this are warned of, m. Filters, and OpenSim's way of
#: wrapping, make some tenths of a millimeter.
TOLERANCE = 1e-3
#: As many muscles are named in one sentence.
_NAMED = 6


@dataclass(frozen=True)
class Difference:
    """How far one quantity of a muscle is from the model's, where it is furthest.

    Parameters
    ----------
    muscle
        Whose.
    coordinate
        About which the moment arm is; empty of a length.
    trial
        In which it is so.
    size, root_mean_square
        Largest absolute difference over the frames of the gait cycle, and the root of its mean square, m: a
        single frame in which a path jumps on or off its surface makes the first alone large.
    """

    muscle: str
    coordinate: str
    trial: str
    size: float
    root_mean_square: float

    def __str__(self) -> str:
        about = f" about {self.coordinate}" if self.coordinate else ""
        size, mean = 1e3 * self.size, 1e3 * self.root_mean_square
        return f"{self.muscle}{about} {size:.2f} mm (rms {mean:.2f}) in {self.trial}"


def geometry_notes(project: Project, log: Callable[[str], None] = lambda line: None) -> tuple[str, ...]:
    """Compare a project's ``MAData`` with its model's own muscle paths at the angles of its gait cycles.

    Parameters
    ----------
    project
        From `read_project`.
    tell
        Called with a line of progress.

    Returns
    -------
    tuple of str
        Sentences: the largest differences, a warning where there are some beyond a millimeter, and what could
        not be compared. None without ``MAData``.

    Raises
    ------
    InputError
        With everything wrong in those files.
    """
    settings = project.settings
    files = {trial.name: trial.files["angles"] for trial in project.trials}
    analyses = read_muscle_analyses(settings.data_directory, files, settings.coordinates)
    if not analyses:
        return ()
    log("comparing MAData with the model's own muscle paths")
    try:
        found = differences(project, analyses)
    except InputError as error:
        return (f"MAData is not compared with the model's muscle paths: {error.problems[0]}",)
    notes = [*_largest(found), *_warning(found)]
    without = [name for name in files if name not in {one.trial for one in analyses}]
    if without:
        notes.append(f"MAData has nothing of {', '.join(without)}")
    return tuple(notes)


def differences(project: Project, analyses: Sequence[MuscleAnalysis]) -> tuple[Difference, ...]:
    """Give each muscle's largest difference of length, and of moment arm about each coordinate.

    Parameters
    ----------
    project
        Whose model, muscles (those with a channel or in an extrapolated group) and gait cycles.
    analyses
        What it keeps of the latter.

    Raises
    ------
    InputError
        If OpenSim cannot analyse the model at these angles.
    """
    muscles = tuple(
        name for own in (*project.channels.values(), *project.extrapolated.values()) for name in own
    )
    recorded = {trial.name: trial for trial in project.trials}
    model = describe_model(project.settings.model_file)
    # Coupled coordinates follow by themselves, and locked ones are where the model holds them.
    free = {one.name for one in model.coordinates if not one.coupled_to and not one.locked}
    spanned = {name for muscle in muscles for name in model.spanned_by(muscle)} & free
    cycles = [_poses(project, recorded[one.trial], spanned) for one in analyses]
    coordinates = tuple(name for name in cycles[0][1] if all(name in names for _, names, _ in cycles))
    rows = [angles[[names.index(name) for name in coordinates]] for _, names, angles in cycles]
    geometry = analyse_muscles(
        project.settings.model_file, muscles, coordinates, np.concatenate(rows, axis=1).T, quiet=True
    )
    furthest: dict[tuple[str, str], Difference] = {}
    first = 0
    for analysis, (time, _, _) in zip(analyses, cycles, strict=True):
        frames = slice(first, first := first + len(time))
        for one in _of_trial(analysis, time, geometry, frames):
            key = (one.muscle, one.coordinate)
            if key not in furthest or furthest[key].size < one.size:
                furthest[key] = one
    return tuple(furthest.values())


def _poses(
    project: Project, trial: Recorded, wanted: set[str]
) -> tuple[Float[np.ndarray, " frame"], tuple[str, ...], Float[np.ndarray, "coordinate frame"]]:
    """Give times of a gait cycle's frames, and names and angles (rad or m) of coordinates that paths need."""
    table = read_storage(trial.files["angles"])
    infos = read_model_file(project.settings.model_file).coordinates
    names, angles = all_angles(table, tuple(info for info in infos if info.name in wanted))
    inside = (table.time >= trial.cycle[0]) & (table.time <= trial.cycle[1])
    return table.time[inside], names, angles[:, inside]


def _of_trial(
    analysis: MuscleAnalysis, time: Float[np.ndarray, " frame"], geometry: PathGeometry, frames: slice
) -> Iterator[Difference]:
    for row, muscle in enumerate(geometry.muscles):
        kept = _column(analysis.length, muscle, time)
        yield from _furthest(muscle, "", analysis.trial, kept, geometry.length[frames, row])
        for place, coordinate in enumerate(geometry.coordinates):
            kept = _column(analysis.moment_arm.get(coordinate), muscle, time)
            own = geometry.moment_arm[frames, place, row]
            yield from _furthest(muscle, coordinate, analysis.trial, kept, own)


def _column(
    table: Storage | None, muscle: str, time: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, " frame"]:
    """Give a muscle's column at these times; NaN where there is none, and beyond the table's ends."""
    places = [] if table is None else find_column(table.columns, muscle)
    if table is None or len(places) != 1:
        return np.full(len(time), np.nan)
    # Files round their times, each as it likes.
    near = 0.5 * float(np.diff(time).min())
    values = np.interp(time, table.time, table.values[:, places[0]])
    return np.where((time >= table.time[0] - near) & (time <= table.time[-1] + near), values, np.nan)


def _furthest(
    muscle: str,
    coordinate: str,
    trial: str,
    kept: Float[np.ndarray, " frame"],
    own: Float[np.ndarray, " frame"],
) -> Iterator[Difference]:
    known = np.isfinite(kept)
    if known.any():
        missed = np.abs(kept - own)[known]
        yield Difference(muscle, coordinate, trial, float(missed.max()), float(np.sqrt(np.mean(missed**2))))


def _largest(found: Sequence[Difference]) -> list[str]:
    if not found:
        return ["MAData holds no lengths and moment arms of this leg's muscles in these cycles: not compared"]
    ends = {
        kind: max(own, key=lambda one: one.size)
        for kind, own in (("lengths", _lengths(found)), ("moment arms", _arms(found)))
        if own
    }
    told = "; of ".join(f"{kind} {one}" for kind, one in ends.items())
    return [f"MAData beside the model's own muscle paths: the largest difference of {told}"]


def _warning(found: Sequence[Difference]) -> list[str]:
    beyond = [
        f"{kind} of {_listed(far)}"
        for kind, own in (("lengths", _lengths(found)), ("moment arms", _arms(found)))
        if (far := sorted((one for one in own if one.size > TOLERANCE), key=lambda one: -one.size))
    ]
    if not beyond:
        return []
    return [
        f"warning: MAData differs from the model's own muscle paths by more than {1e3 * TOLERANCE:g} mm: "
        f"{'; '.join(beyond)}. It is not used, as lengths and moment arms are calculated from the model; see "
        "whether it was made with this model and these angles"
    ]


def _lengths(found: Sequence[Difference]) -> list[Difference]:
    return [one for one in found if not one.coordinate]


def _arms(found: Sequence[Difference]) -> list[Difference]:
    return [one for one in found if one.coordinate]


def _listed(far: Sequence[Difference]) -> str:
    told = ", ".join(map(str, far[:_NAMED]))
    return told if len(far) <= _NAMED else f"{told} and {len(far) - _NAMED} more"
