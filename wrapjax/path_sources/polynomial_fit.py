"""Polynomial fit of a subject's muscle paths, in memory (`Fit`) and on disk (``load_fit``)."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.paths import AbstractPath
from wrapjax.geometry.surrogates.surrogate import PathSurrogate, surrogate_from_arrays
from wrapjax.io.files import BusyError, content_hash, new_folder, write_atomically, write_json, write_text
from wrapjax.io.json_and_arrays import load_arrays, load_json
from wrapjax.model.freedom import Freedom, nga_freedom, with_wraps
from wrapjax.model.parameters import ModelParameters
from wrapjax.path_sources.exact import NO_WRAPS_TO_FREE
from wrapjax.path_sources.model_inputs import model_parameters
from wrapjax.path_sources.polynomial_paths import (
    WrapFit,
    calibrated_polynomials,
    polynomial_freedom,
    polynomial_paths,
    wrap_fit_from,
    wrapped_polynomial_paths,
)
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

    from wrapjax.report.paths.fit_wraps import SampledPath


@dataclass(frozen=True)
class PathError:
    """Errors of one muscle's polynomial path in poses that were not used in fitting, pooled over coordinates.

    After `wrapjax.fit_wraps` they are those on physiological validation samples of the wrap parameters, or
    with nominal wraps if no sample is physiological.
    """

    #: Whether the muscle has wraps.
    wrapped: bool
    #: Root mean square and largest absolute error of length and moment arms, mm.
    length_rmse_mm: float
    length_max_mm: float
    moment_arm_rmse_mm: float
    moment_arm_max_mm: float
    #: Number of coefficients of the polynomial.
    terms: int

    @classmethod
    def of(
        cls,
        length: Float[np.ndarray, "..."],
        moment_arm: Float[np.ndarray, "..."],
        *,
        wrapped: bool,
        terms: int,
    ) -> PathError:
        """Compute the summary of errors in m; zero where there are none."""
        return cls(
            wrapped=wrapped,
            length_rmse_mm=1e3 * _root_mean_square(length),
            length_max_mm=1e3 * float(np.abs(length).max(initial=0.0)),
            moment_arm_rmse_mm=1e3 * _root_mean_square(moment_arm),
            moment_arm_max_mm=1e3 * float(np.abs(moment_arm).max(initial=0.0)),
            terms=terms,
        )


@dataclass(frozen=True)
class Fit:
    """Polynomial fit of a subject's muscle paths, with its errors.

    Parameters
    ----------
    key
        Hash of the inputs of the fit, which is valid for one subject alone.
    surrogate
        Polynomials for length and moment arms.
    errors
        Errors of the polynomials by muscle.
    touching
        Names of the muscles that touch a wrap in a recorded frame.
    seconds
        Computing times by step, s.
    geometry
        Source of the fitted lengths and moment arms, see `wrapjax.fit`.
    seed
        Seed of the random poses.
    wraps
        Dependence of the coefficients on wrap parameters, required by PGA; None before `wrapjax.fit_wraps`.
    """

    key: str
    surrogate: PathSurrogate
    errors: dict[str, PathError]
    touching: tuple[str, ...]
    seconds: dict[str, float]
    geometry: str
    seed: int
    wraps: WrapFit | None = None

    def freedom(self, method: str, subject: Subject, surfaces: str = "touched") -> Freedom:
        """Build the freedom of a method: paths held (NGA), coefficients (SGA, LSGA) or wraps (PGA) freed.

        Parameters
        ----------
        method
            Name of the method.
        subject
            Subject of the fit.
        surfaces
            Wraps that PGA frees, one of `SURFACES`.

        Raises
        ------
        InputError
            If there is nothing to free, or PGA is asked for and the fit has no ``wraps``.
        """
        if method != "PGA":
            return polynomial_freedom(method, subject, self.surrogate, self.touching)
        if self.wraps is None:
            raise InputError(
                Problem(
                    str(subject.folder),
                    "PGA adjusts wrapping cylinders, and this fit has no samples of them",
                    hint="make it with 'wrapjax fit', or use --geometry engine",
                )
            )
        freed = self.wraps.freed(subject.muscles.names, surfaces)
        if not freed.names:
            raise InputError(
                Problem(
                    str(subject.model_file),
                    NO_WRAPS_TO_FREE[surfaces],
                    hint="use NGA or SGA",
                )
            )
        return with_wraps(nga_freedom(model_parameters(subject)), method, freed)

    def calibrated(self, subject: Subject, freedom: Freedom, parameters: ModelParameters) -> PathSurrogate:
        """Compute the subject's polynomials with calibrated coefficients; see `calibrated_polynomials`."""
        return calibrated_polynomials(subject, self.surrogate, self.wraps, freedom, parameters)

    def paths(self, subject: Subject, trials: Trials, freedom: Freedom) -> AbstractPath:
        """Evaluate the paths over cycles as functions of what the freedom frees."""
        if freedom.wraps is None or self.wraps is None:
            return polynomial_paths(subject, trials, self.surrogate, freedom)
        return wrapped_polynomial_paths(subject, trials, self.surrogate, self.wraps, freedom.wraps)

    def save(
        self,
        folder: str | Path,
        *,
        subject: Subject | None = None,
        force: bool = False,
        motion: bool = False,
    ) -> None:
        """Write ``fit.json``, ``fit.npz`` and ``report.html`` into a new folder.

        Parameters
        ----------
        folder
            Folder to create; it is written atomically.
        subject
            Subject of the fit. If given, the report names it and shows the sampled paths, accepted and
            rejected, of every muscle that touches a wrap; computing them takes half a minute.
        force
            Replace an existing folder.
        motion
            Also write ``motion.html``, which shows the subject's paths in motion; takes seconds.

        Raises
        ------
        InputError
            If the folder exists and ``force`` is not set, or cannot be created; or if the fit is not one of
            the subject.
        """
        from wrapjax.path_sources.path_samples import REPORTED_SAMPLES, sampled_paths
        from wrapjax.report.model_view.page import write_beside_report
        from wrapjax.report.model_view.shown import shown_fit
        from wrapjax.report.paths.fit_page import render_fit
        from wrapjax.report.provenance import path_from

        if subject is not None:
            self.require_subject(subject, "fit")
        with new_folder(Path(folder), force=force) as temporary:
            content = self.summary()
            if subject is not None:
                content["subject_folder"] = path_from(temporary, subject.folder)
            self._write(temporary, content)
            wraps_of = {} if self.wraps is None else self.wraps.wraps_of
            shown = [name for name in self.touching if wraps_of.get(name)]
            paths: Iterable[SampledPath] = ()
            if subject is not None:
                paths = sampled_paths(subject, self, shown, count=REPORTED_SAMPLES)
            link = ""
            if motion and subject is not None:
                link = write_beside_report(temporary, shown_fit(self.surrogate, subject))
            write_text(temporary / "report.html", render_fit(content, subject, paths, link))

    def write_to_cache(self, folder: Path) -> None:
        """Write the fit without a report to a folder of the cache, replacing what is there."""
        # A process that is writing the same fit leaves the same content.
        with suppress(BusyError), new_folder(folder, force=True) as temporary:
            self._write(temporary, self.summary())

    def require_subject(self, subject: Subject, place: str) -> None:
        """Raise an error if this is not a fit of the subject's model and all its muscles.

        Parameters
        ----------
        subject
            Subject that the fit must belong to.
        place
            Folder or argument that the error names.

        Raises
        ------
        InputError
            If the fit is not one of the subject.
        """
        missing = [name for name in subject.muscles.names if name not in self.surrogate.muscles]
        if missing or self.key.split("-")[0] != content_hash(subject.model_file):
            reason = f"it lacks muscle '{missing[0]}'" if missing else "it was made from another model file"
            raise InputError(
                Problem(
                    place,
                    f"is no fit of subject '{subject.name}': {reason}",
                    hint="make it anew with 'wrapjax fit'",
                )
            )

    def summary(self) -> dict[str, Any]:
        """Return the content of ``fit.json``."""
        return {
            "schema": 1,
            "key": self.key,
            "seconds": self.seconds,
            "muscles": {name: vars(error) for name, error in self.errors.items()},
            "touching": list(self.touching),
            "geometry": self.geometry,
            "seed": self.seed,
            "wraps": {} if self.wraps is None else self.wraps.content(),
            "wraps_of": None if self.wraps is None else self.wraps.wraps_of,
            "thresholds": None if self.wraps is None else vars(self.wraps.thresholds),
        }

    def to_dataset(self) -> Dataset:
        """Return the errors by muscle, in m, as an `xarray.Dataset`."""
        from wrapjax.report.labelled.geometry import fit_dataset

        return fit_dataset(self)

    def plot_errors(self) -> Figure:
        """Draw the errors of lengths and moment arms (mm) by muscle."""
        from wrapjax.report.paths.fit_page import error_figure

        return error_figure(self.summary())

    def _write(self, folder: Path, content: dict[str, Any]) -> None:
        arrays = self.surrogate.arrays()
        if self.wraps is not None:
            arrays |= self.wraps.arrays()

        def write(path: Path) -> None:
            np.savez(path, allow_pickle=False, **arrays)

        write_atomically(folder / "fit.npz", write)
        write_json(folder / "fit.json", content)


def load_fit(folder: str | Path, subject: Subject | None = None) -> Fit:
    """Read a fit from a folder that `Fit.save` or ``wrapjax fit`` wrote.

    Parameters
    ----------
    folder
        Folder of the fit.
    subject
        If given, the fit must be one of this subject's model and have all its muscles.

    Returns
    -------
    Fit
        Polynomials, to be given to `calibrate` as ``fit``.

    Raises
    ------
    InputError
        If the folder is not that of a fit, is damaged, or the fit is not one of ``subject``.

    Examples
    --------
    >>> fitted = load_fit("fit", subject)  # doctest: +SKIP
    >>> calibrate(subject, "SGA", fitted)  # doctest: +SKIP
    """
    loaded = read_fit(Path(folder))
    if subject is not None:
        loaded.require_subject(subject, str(folder))
    return loaded


def _root_mean_square(values: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def read_fit(folder: Path) -> Fit:
    """Read a fit without checking its subject."""
    json_file, array_file = folder / "fit.json", folder / "fit.npz"
    for file in (json_file, array_file):
        if not file.is_file():
            raise InputError(Problem(str(folder), f"is no FIT folder: {file.name} is missing"))
    try:
        content, arrays = load_json(json_file), load_arrays(array_file)
        # Names of the arrays of wraps contain a dot.
        outer = {name: value for name, value in arrays.items() if "." not in name}
        wraps = None
        if content["wraps_of"] is not None:
            # Earlier fits do not store thresholds and have the defaults.
            thresholds = content.get("thresholds", {})
            wraps = wrap_fit_from(arrays, content["wraps"], content["wraps_of"], thresholds)
        return Fit(
            key=content["key"],
            surrogate=surrogate_from_arrays(outer),
            errors={name: PathError(**entry) for name, entry in content["muscles"].items()},
            touching=tuple(content["touching"]),
            seconds=content["seconds"],
            geometry=content["geometry"],
            seed=content["seed"],
            wraps=wraps,
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            Problem(str(folder), f"is damaged ({error})", hint="make it anew with 'wrapjax fit'")
        ) from error
