"""``compare``: calibrate persons by several methods, and test whether the methods differ."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

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
from wrapjax.subject.subject import Subject, read_legs

if TYPE_CHECKING:
    from xarray import Dataset

    from wrapjax.comparison.samples import ComparedLeg
    from wrapjax.report.comparison_summary import Row

#: Where NGA and PGA may take paths from.
GEOMETRIES = ("surrogate", "engine")
#: The methods that need no polynomials.
BY_ENGINE = ("NGA", "PGA")


@dataclass(frozen=True)
class Comparison:
    """Legs calibrated by several methods.

    Parameters
    ----------
    methods
        The first is the one that others are compared with.
    calibrations
        One row a subject, one column a method.
    labels
        Names of the subjects, no two alike: also of their folders.
    journal
        Where unfinished work was kept.
    """

    methods: tuple[str, ...]
    calibrations: tuple[tuple[Calibration, ...], ...]
    labels: tuple[str, ...]
    checkpoints: Path | None = None

    @property
    def converged(self) -> bool:
        """Whether every calibration did."""
        return all(one.status.converged for row in self.calibrations for one in row)

    @cached_property
    def legs(self) -> tuple[ComparedLeg, ...]:
        """Every calibrated leg, both of a person whose legs were calibrated together."""
        from wrapjax.comparison.samples import ComparedLeg
        from wrapjax.report.run_folder import OTHER_LEG

        found: list[ComparedLeg] = []
        taken = set(self.labels)
        for label, row in zip(self.labels, self.calibrations, strict=True):
            moves = any(one.result.freedom.wraps is not None for one in row)
            for number, leg in enumerate(row[0].legs):
                within = f"/{OTHER_LEG}" if number else ""
                own = file_name(leg.subject.name)
                name = label if not number else own if own not in taken else f"{label} (other leg)"
                taken.add(name)
                found.append(
                    ComparedLeg(
                        name,
                        leg.subject,
                        {
                            method: one.legs[number].result
                            for method, one in zip(self.methods, row, strict=True)
                        },
                        {method: f"{label}/{method}{within}" for method in self.methods},
                        describe_model(leg.subject.model_file) if moves else None,
                        {method: _source(one) for method, one in zip(self.methods, row, strict=True)},
                    )
                )
        return tuple(found)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """Means, spreads and tests of everything that is compared."""
        from wrapjax.report.comparison_summary import comparison_rows

        return comparison_rows(self.legs, self.methods)

    @property
    def dataset(self) -> Dataset:
        """Moments, their errors and parameters by method, as an `xarray.Dataset` with units."""
        from wrapjax.report.labelled_arrays import comparison_dataset

        return comparison_dataset(self.legs, self.methods)

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``<subject>/<METHOD>/`` for every calibration, ``comparison.json``, tables and report."""
        from wrapjax.report.comparison_page import write_comparison

        with new_folder(Path(folder), force=force) as place:
            for label, row in zip(self.labels, self.calibrations, strict=True):
                for method, one in zip(self.methods, row, strict=True):
                    # Journals are kept until all is written.
                    replace(one, checkpoints=None).save(place / label / method)
            write_comparison(self.legs, self.methods, self.rows, place)
        if self.checkpoints is not None:
            shutil.rmtree(self.checkpoints, ignore_errors=True)


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
    """Calibrate every subject by every method, and test whether the methods differ.

    What feeds what: SGA and LSGA change polynomials, so that they always take those of `fit`. NGA and PGA
    take them too (``geometry="surrogate"``), or the exact engine's paths (``geometry="engine"``). All four
    start from one geometry: polynomials are fitted to OpenSim's paths, but to the exact engine's as soon as
    a method takes those or PGA is among the methods. NGA held by the engine and SGA started from
    polynomials then differ by the error of the polynomials alone, as `fit` reports it.

    Where a subject names its ``other_leg``, both legs are calibrated together and both are compared; the
    other leg is not calibrated again if it is among the subjects, too.

    Parameters
    ----------
    subjects
        From `load_subject`.
    methods
        The first is the one that others are compared with.
    geometry
        Where NGA and PGA take paths from: ``surrogate`` or ``engine``; see above.
    solver, starts, seed, callback, curves
        As in `calibrate`, for every calibration; paths are fitted by the same seed.
    processes
        As in `fit`.
    quiet
        Print no progress.
    journal
        Folder in which to keep where the work stands, so that it can be resumed; removed when the
        result is saved.
    resume
        Go on with the journal's work instead of beginning anew.

    Returns
    -------
    Comparison
        Whether all converged is in ``converged``.

    Raises
    ------
    InputError
        Before the long work, if a method is not known or frees nothing of a subject, or if subjects
        cannot be told apart.
    KeyboardInterrupt
        If interrupted; the journal then holds what was done.
    """
    methods = _checked(methods)
    if geometry not in GEOMETRIES:
        raise ValueError(f"unknown geometry '{geometry}': expected one of {', '.join(GEOMETRIES)}")
    persons = subjects_to_calibrate(subjects)
    labels = unique_labels(persons)
    sources = [
        _sources(methods, person, geometry, seed=seed, processes=processes, quiet=quiet) for person in persons
    ]
    if checkpoints is not None:
        _open(checkpoints, resume=resume)
    done = []
    for label, person, source in zip(labels, persons, sources, strict=True):
        row = []
        for method in methods:
            print_progress(f"calibrating {label} by {method}", quiet=quiet)
            place = None if checkpoints is None else checkpoints / label / method
            one = calibrate(
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
            if one.status is Status.interrupted:
                raise KeyboardInterrupt
            row.append(one)
        done.append(tuple(row))
    return Comparison(methods, tuple(done), labels, checkpoints)


def _source(calibration: Calibration) -> str:
    return "engine" if isinstance(calibration.fit, ExactGeometry) else "surrogate"


def _checked(methods: Sequence[str]) -> tuple[str, ...]:
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


def _sources(
    methods: Sequence[str],
    person: Subject,
    geometry: str,
    *,
    seed: int,
    processes: int | None,
    quiet: bool,
) -> dict[str, Fit | ExactGeometry]:
    """Say where each method takes a subject's paths from.

    Raises
    ------
    InputError
        Before the long work, if a method frees nothing.
    """
    legs = read_legs(person)
    by_engine = set(methods) & set(BY_ENGINE) if geometry == "engine" else set()
    if by_engine and len(legs) > 1:
        raise InputError(
            Problem(
                str(person.folder),
                "names its other leg, and legs are calibrated together through polynomials only",
                hint="use --geometry surrogate, or take other_leg out of subject.toml",
            )
        )
    found: dict[str, Fit | ExactGeometry] = {}
    if by_engine:
        print_progress(f"laying the paths of {person.name} by the exact engine", quiet=quiet)
        found |= dict.fromkeys(by_engine, exact_geometry(person))
    by_polynomials = [method for method in methods if method not in by_engine]
    if by_polynomials:
        source = "engine" if by_engine else "opensim"
        fitted = fit_for_methods(by_polynomials, person, source, seed=seed, processes=processes, quiet=quiet)
        found |= dict.fromkeys(by_polynomials, fitted)
    for leg in legs:
        own = (
            found
            if leg is person
            else {method: matching_path_source(fit, leg) for method, fit in found.items()}
        )
        for method in methods:
            method_freedom(method, leg, own[method])
    return found


def _open(checkpoints: Path, *, resume: bool) -> None:
    if resume and not checkpoints.is_dir():
        raise InputError(
            Problem(str(checkpoints), "holds no interrupted work to resume", hint="leave out --resume")
        )
    if not resume:
        shutil.rmtree(checkpoints, ignore_errors=True)
    checkpoints.mkdir(parents=True, exist_ok=True)
