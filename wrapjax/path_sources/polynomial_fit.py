"""What ``fit`` gives: a subject's muscle paths as polynomials, in memory and on disk."""

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
from wrapjax.geometry.surrogate import PathSurrogate, surrogate_from_arrays
from wrapjax.io.files import content_hash, new_folder, write_atomically, write_json, write_text
from wrapjax.io.json_and_arrays import load_arrays, load_json
from wrapjax.io.locks import BusyError
from wrapjax.model.freedom import Freedom, nga_freedom, with_wraps
from wrapjax.model.parameters import ModelParameters
from wrapjax.path_sources.exact import NO_CYLINDER
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
    from wrapjax.report.fit_wraps import SampledPath


@dataclass(frozen=True)
class PathError:
    """Errors of one muscle's path on poses never used in fitting, pooled over coordinates.

    Once its cylinders have been sampled: on samples never used either, those that are physiological. Where
    none is, errors are those with the model's own cylinders.
    """

    wrapped: bool
    length_rmse_mm: float
    length_max_mm: float
    moment_arm_rmse_mm: float
    moment_arm_max_mm: float
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
        """Pool errors in m; none at all count as zero."""
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
    geometry, seed
        What it was made with.
    wraps
        How the paths follow their cylinders, which PGA needs; None until `wrapjax.fit_wraps` has sampled
        them.
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
        """Say what a method frees: nothing of the paths (NGA), their coefficients (SGA, LSGA) or cylinders.

        Of the cylinders, PGA frees those that ``surfaces`` names (`SURFACES`).

        Raises
        ------
        InputError
            Where there is nothing to free; for PGA also where cylinders have not been sampled.
        """
        if method != "PGA":
            return polynomial_freedom(method, subject, self.surrogate, self.touching)
        if self.wraps is None:
            raise InputError(
                Problem(
                    str(subject.folder),
                    "PGA moves cylinders, and this fit has not sampled them",
                    hint="make it with 'wrapjax fit', or use --geometry engine",
                )
            )
        freed = self.wraps.freed(subject.muscles.names, surfaces)
        if not freed.names:
            raise InputError(
                Problem(
                    str(subject.model_file),
                    NO_CYLINDER[surfaces],
                    hint="use NGA or SGA",
                )
            )
        return with_wraps(nga_freedom(model_parameters(subject)), method, freed)

    def calibrated(self, subject: Subject, freedom: Freedom, parameters: ModelParameters) -> PathSurrogate:
        """Give the subject's polynomials as these parameters change them."""
        return calibrated_polynomials(subject, self.surrogate, self.wraps, freedom, parameters)

    def paths(self, subject: Subject, trials: Trials, freedom: Freedom) -> AbstractPath:
        """Evaluate the paths over cycles, with all that the freedom may change."""
        if freedom.wraps is None or self.wraps is None:
            return polynomial_paths(subject, trials, self.surrogate, freedom)
        return wrapped_polynomial_paths(subject, trials, self.surrogate, self.wraps, freedom.wraps)

    def save(self, folder: str | Path, *, subject: Subject | None = None, force: bool = False) -> None:
        """Write ``fit.json``, ``fit.npz`` and ``report.html`` into a new folder.

        Parameters
        ----------
        folder
            Where to; it appears when complete.
        subject
            Whose fit it is. With it the report names the person and shows, of every muscle that touches
            a cylinder, which sampled paths were accepted; these are laid once more, half a minute's work.
        force
            Replace a folder that exists.

        Raises
        ------
        InputError
            If the folder exists and ``force`` is not set, or cannot be created; or if the fit is not the
            subject's.
        """
        from wrapjax.path_sources.sample_figures import REPORTED_SAMPLES, sampled_paths
        from wrapjax.report.fit_page import render_fit

        if subject is not None:
            self.require_subject(subject, "fit")
        with new_folder(Path(folder), force=force) as temporary:
            self._write(temporary)
            wraps_of = {} if self.wraps is None else self.wraps.wraps_of
            shown = [name for name in self.touching if wraps_of.get(name)]
            paths: Iterable[SampledPath] = ()
            if subject is not None:
                paths = sampled_paths(subject, self, shown, count=REPORTED_SAMPLES)
            write_text(temporary / "report.html", render_fit(self.content(), subject, paths))

    def keep(self, folder: Path) -> None:
        """Put the fit into a cache: whatever is there is replaced, and there is no report."""
        # Whoever is writing the same one leaves what this would.
        with suppress(BusyError), new_folder(folder, force=True) as temporary:
            self._write(temporary)

    def require_subject(self, subject: Subject, place: str) -> None:
        """Raise an error if this is not a fit of the subject's model and of all its muscles.

        Parameters
        ----------
        place
            What the error names.
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

    def content(self) -> dict[str, Any]:
        """Describe the fit in plain values: what ``fit.json`` holds."""
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

    def _write(self, folder: Path) -> None:
        arrays = self.surrogate.arrays()
        if self.wraps is not None:
            arrays |= self.wraps.arrays()

        def write(path: Path) -> None:
            np.savez(path, allow_pickle=False, **arrays)

        write_atomically(folder / "fit.npz", write)
        write_json(folder / "fit.json", self.content())


def load_fit(folder: str | Path, subject: Subject | None = None) -> Fit:
    """Read a fit that `Fit.save` wrote.

    Parameters
    ----------
    folder
        Where it is.
    subject
        If given, a fit that does not cover its muscles and coordinates, or is of another model, is refused.
    """
    found = read_fit(Path(folder))
    if subject is not None:
        found.require_subject(subject, str(folder))
    return found


def _root_mean_square(values: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def read_fit(folder: Path) -> Fit:
    """Read a fit, whoever's it is."""
    json_file, array_file = folder / "fit.json", folder / "fit.npz"
    for file in (json_file, array_file):
        if not file.is_file():
            raise InputError(Problem(str(folder), f"is no FIT folder: {file.name} is missing"))
    try:
        content, arrays = load_json(json_file), load_arrays(array_file)
        # Arrays of cylinders have a dot in their names.
        outer = {name: value for name, value in arrays.items() if "." not in name}
        wraps = None
        if content["wraps_of"] is not None:
            # Fits made before they said so were held to the defaults.
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
