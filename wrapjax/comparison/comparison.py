"""Calibration of subjects by several methods, and tests of whether the methods differ."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wrapjax.calibration.calibration import STARTS, Calibration, calibrate
from wrapjax.calibration.problem import METHODS, fit_for_methods, matching_path_source, method_freedom
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.multistart import IterationCallback
from wrapjax.comparison.samples import file_name, subjects_to_calibrate, unique_labels
from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import new_folder
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.exact import ExactGeometry, exact_geometry
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.progress import print_progress
from wrapjax.renamed import renamed_arguments
from wrapjax.subject.gait_alone import with_gait_alone
from wrapjax.subject.subject import Subject, read_legs

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

    from wrapjax.comparison.samples import ComparedLeg
    from wrapjax.report.comparison.summary import Row

#: Sources of the muscle paths of NGA and PGA.
GEOMETRIES = ("surrogate", "engine")
#: Methods that can use the exact engine instead of polynomials.
ENGINE_METHODS = ("NGA", "PGA")


@dataclass(frozen=True)
class Comparison:
    """Subjects calibrated by several methods.

    Parameters
    ----------
    methods
        Names of the methods; the first is the reference of the tests.
    calibrations
        Calibrations, one row for each subject and one column for each method.
    labels
        Unique names of the subjects, also of their folders.
    checkpoints
        Folder of the checkpoints; None if there is none.
    """

    methods: tuple[str, ...]
    calibrations: tuple[tuple[Calibration, ...], ...]
    labels: tuple[str, ...]
    checkpoints: Path | None = None

    @property
    def converged(self) -> bool:
        """Whether all calibrations converged."""
        return all(calibration.status.converged for row in self.calibrations for calibration in row)

    @cached_property
    def legs(self) -> tuple[ComparedLeg, ...]:
        """All calibrated legs; both legs of a person where they were calibrated together."""
        from wrapjax.comparison.samples import ComparedLeg
        from wrapjax.report.calibration.run_page import OTHER_LEG

        legs: list[ComparedLeg] = []
        names = set(self.labels)
        for label, row in zip(self.labels, self.calibrations, strict=True):
            frees_wraps = any(calibration.result.freedom.wraps is not None for calibration in row)
            for number, leg in enumerate(row[0].legs):
                within = f"/{OTHER_LEG}" if number else ""
                other_name = file_name(leg.subject.name)
                if number == 0:
                    name = label
                else:
                    name = other_name if other_name not in names else f"{label} (other leg)"
                names.add(name)
                legs.append(
                    ComparedLeg(
                        name,
                        leg.subject,
                        {
                            method: calibration.legs[number].result
                            for method, calibration in zip(self.methods, row, strict=True)
                        },
                        {method: f"{label}/{method}{within}" for method in self.methods},
                        describe_model(leg.subject.model_file) if frees_wraps else None,
                        {
                            method: _path_source(calibration)
                            for method, calibration in zip(self.methods, row, strict=True)
                        },
                    )
                )
        return tuple(legs)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """Means, standard deviations and tests of all compared quantities."""
        from wrapjax.report.comparison.summary import comparison_rows

        return comparison_rows(self.legs, self.methods)

    def to_dataset(self) -> Dataset:
        """Return moments, moment errors and parameters by method, as an `xarray.Dataset` with units."""
        from wrapjax.report.labelled.arrays import comparison_dataset

        return comparison_dataset(self.legs, self.methods)

    def summary(self) -> dict[str, Any]:
        """Return the content of ``comparison.json``."""
        from wrapjax.report.comparison.summary import describe_comparison

        return describe_comparison(self.legs, self.methods, self.rows)

    def plot_moments(self) -> Figure:
        """Draw measured moments and those by every method (N m) over the gait cycle."""
        from wrapjax.report.comparison.figures import compared_moments_figure

        return compared_moments_figure(self.legs, self.methods)

    def plot_moment_arms(self) -> Figure:
        """Draw moment arms (m) by every method over the gait cycle."""
        from wrapjax.report.comparison.figures import compared_moment_arms_figure

        return compared_moment_arms_figure(self.legs, self.methods)

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``<subject>/<METHOD>/`` for each calibration, ``comparison.json``, tables and report."""
        from wrapjax.report.comparison.page import write_comparison

        with new_folder(Path(folder), force=force) as place:
            for label, row in zip(self.labels, self.calibrations, strict=True):
                for method, calibration in zip(self.methods, row, strict=True):
                    # Checkpoints are kept until everything is written.
                    replace(calibration, checkpoints=None).save(place / label / method)
            write_comparison(self.legs, self.methods, self.rows, place)
        if self.checkpoints is not None:
            shutil.rmtree(self.checkpoints, ignore_errors=True)


@renamed_arguments(journal="checkpoints")
def compare(
    subjects: Sequence[Subject],
    methods: Sequence[str] = METHODS,
    *,
    geometry: str = "surrogate",
    solver: AugmentedLagrangian | None = None,
    starts: int = STARTS,
    seed: int = 0,
    callback: IterationCallback | None = None,
    curves: str = "paper",
    processes: int | None = None,
    quiet: bool = True,
    checkpoints: Path | None = None,
    resume: bool = False,
) -> Comparison:
    """Calibrate all subjects by several methods, and test whether the methods differ.

    SGA and LSGA change polynomials and always use those of `fit`. NGA and PGA use them too
    (``geometry="surrogate"``), or the exact engine's paths (``geometry="engine"``). All methods start from
    the same geometry: polynomials are fitted to OpenSim's paths, or to the exact engine's if a method uses
    those or PGA is among the methods. The initial moments of NGA by the engine and of SGA then differ only by
    the error of the polynomials, as reported by `fit`.

    If a subject names its ``other_leg``, both legs are calibrated together and both are compared. The other
    leg is not calibrated again if it is among the subjects.

    Parameters
    ----------
    subjects
        Subjects from `load_subject`.
    methods
        Names of two or more methods; the others are tested against the first.
    geometry
        Source of the muscle paths of NGA and PGA: ``surrogate`` or ``engine``, see above.
    solver, starts, seed, callback, curves
        As in `calibrate`, for all calibrations; ``seed`` is also that of `fit`.
    processes
        Number of processes, as in `fit`.
    quiet
        Print no progress.
    checkpoints
        Folder for checkpoints, from which interrupted calibrations can be resumed; it is deleted when the
        result is saved. None for no checkpoints.
    resume
        Continue from the checkpoints instead of starting again.

    Returns
    -------
    Comparison
        Calibrations and tests; ``converged`` tells whether all calibrations converged.

    Raises
    ------
    InputError
        Before the calibrations, if a method is unknown or frees nothing of a subject, if subjects have the
        same name and side, or if there are no checkpoints to resume.
    KeyboardInterrupt
        If interrupted; the checkpoints then hold the finished part.
    """
    methods = _check_methods(methods)
    if geometry not in GEOMETRIES:
        raise ValueError(f"unknown geometry '{geometry}': expected one of {', '.join(GEOMETRIES)}")
    persons = subjects_to_calibrate([with_gait_alone(one, "a comparison of methods") for one in subjects])
    labels = unique_labels(persons)
    sources = [
        _path_sources(methods, person, geometry, seed=seed, processes=processes, quiet=quiet)
        for person in persons
    ]
    if checkpoints is not None:
        _open_checkpoints(checkpoints, resume=resume)
    calibrations = []
    for label, person, source in zip(labels, persons, sources, strict=True):
        row = []
        for method in methods:
            print_progress(f"calibrating {label} by {method}", quiet=quiet)
            place = None if checkpoints is None else checkpoints / label / method
            calibration = calibrate(
                person,
                method,
                source[method],
                solver=solver,
                starts=starts,
                seed=seed,
                callback=callback,
                curves=curves,
                checkpoints=place,
                resume=place is not None and (place / "question.json").exists(),
            )
            if calibration.status is Status.interrupted:
                raise KeyboardInterrupt
            row.append(calibration)
        calibrations.append(tuple(row))
    return Comparison(methods, tuple(calibrations), labels, checkpoints)


def _path_source(calibration: Calibration) -> str:
    return "engine" if isinstance(calibration.fit, ExactGeometry) else "surrogate"


def _check_methods(methods: Sequence[str]) -> tuple[str, ...]:
    problems = [
        Problem("methods", f"'{method}' is not known", hint=nearest_name(method, METHODS))
        for method in dict.fromkeys(methods)
        if method not in METHODS
    ]
    if not problems and len(set(methods)) < max(2, len(methods)):
        problems = [
            Problem("methods", f"expected two or more, each once, found {', '.join(methods) or 'none'}")
        ]
    if problems:
        raise InputError(problems)
    return tuple(methods)


def _path_sources(
    methods: Sequence[str],
    person: Subject,
    geometry: str,
    *,
    seed: int,
    processes: int | None,
    quiet: bool,
) -> dict[str, Fit | ExactGeometry]:
    """Make the muscle paths of a subject for each method.

    Raises
    ------
    InputError
        If a method frees nothing, or both legs of a person would be calibrated with the exact engine.
    """
    legs = read_legs(person)
    by_engine = set(methods) & set(ENGINE_METHODS) if geometry == "engine" else set()
    if by_engine and len(legs) > 1:
        raise InputError(
            Problem(
                str(person.folder),
                "names its other leg, and legs are calibrated together through polynomials only",
                hint="use --geometry surrogate, or take other_leg out of subject.toml",
            )
        )
    paths: dict[str, Fit | ExactGeometry] = {}
    if by_engine:
        print_progress(f"computing the muscle paths of {person.name} by the exact engine", quiet=quiet)
        paths |= dict.fromkeys(by_engine, exact_geometry(person))
    by_polynomials = [method for method in methods if method not in by_engine]
    if by_polynomials:
        fitted_to = "engine" if by_engine else "opensim"
        fitted = fit_for_methods(
            by_polynomials, person, fitted_to, seed=seed, processes=processes, quiet=quiet
        )
        paths |= dict.fromkeys(by_polynomials, fitted)
    for leg in legs:
        leg_paths = (
            paths
            if leg is person
            else {method: matching_path_source(source, leg) for method, source in paths.items()}
        )
        for method in methods:
            method_freedom(method, leg, leg_paths[method])
    return paths


def _open_checkpoints(checkpoints: Path, *, resume: bool) -> None:
    if resume and not checkpoints.is_dir():
        raise InputError(
            Problem(str(checkpoints), "holds no interrupted work to resume", hint="leave out --resume")
        )
    if not resume:
        shutil.rmtree(checkpoints, ignore_errors=True)
    checkpoints.mkdir(parents=True, exist_ok=True)
