"""Inputs, options and software versions of a calibration: the content of ``settings.json``."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.io.files import content_hash
from wrapjax.model.parameters import QUANTITIES
from wrapjax.subject.subject import Subject

PACKAGES = ("wrapjax", "jax", "jaxlib", "equinox", "numpy", "scipy", "opensim", "matplotlib")


def describe_settings(subject: Subject, result: CalibrationResult, run: Path) -> dict[str, Any]:
    """Describe the inputs, options and software versions of a calibration.

    Parameters
    ----------
    subject, result
        Calibrated subject and result of the calibration.
    run
        Folder of the result; paths are relative to it.

    Returns
    -------
    dict
        Subject, drive of the muscles, solver, seed of each start (None for the model's own values),
        trials, freed parameters with bounds and priors (lists in the order of ``muscles``, SI units; an
        infinite standard deviation where there is no prior), path source, for freed paths the number of
        modes by muscle and the scaling of coordinates in their terms, versions and platform.
    """
    trials = subject.trials
    driven = subject.channel_of
    return {
        "schema": 1,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "subject": {
            "name": subject.name,
            "folder": path_from(run, subject.folder),
            "model_file": path_from(run, subject.model_file),
            # None where the file is gone by now.
            "model_hash": content_hash(subject.model_file) if subject.model_file.is_file() else None,
            "mass_kg": subject.mass_kg,
            "side": subject.side,
            "paretic": subject.paretic,
            "other_leg": None if subject.other_leg is None else path_from(run, subject.other_leg),
        },
        "method": result.method,
        "curves": result.curves,
        "tendon": result.tendon,
        "muscle_law": result.muscle_law,
        "solver": _options(result.solver),
        "starts": [outcome.seed for outcome in result.outcomes],
        "coordinates": result.coordinates,
        "channels": {
            channel: [name for name, driver in driven.items() if driver == channel]
            for channel in trials.channels
        },
        "undriven_muscles": subject.undriven_muscles,
        # Synergy signals are components @ (EMG / largest - mean), then 1; weights are in parameters.csv.
        "synergies": None
        if subject.synergies is None
        else {**vars(subject.synergies.basis), "groups": subject.synergies.groups},
        "activation_groups": subject.activation_groups,
        "fiber_length_groups": subject.fiber_length_groups,
        "notes": subject.notes,
        "trials": {
            name: {"use": use, "speed_m_s": float(speed), "start_s": float(time[0]), "end_s": float(time[-1])}
            for name, use, speed, time in zip(
                result.trials, result.uses, result.speeds, result.time, strict=True
            )
        },
        "muscles": result.muscles,
        "paths": {
            "source": "exact" if result.calibrated_paths is None else "polynomials",
            "geometry": result.geometry,
        },
        "freed": {
            parameter.name: {
                "unit": QUANTITIES[parameter.name].unit,
                "lower": parameter.lower,
                "upper": parameter.upper,
                "prior_mean": parameter.prior_mean,
                "prior_sd": parameter.prior_sd,
            }
            for parameter in result.freedom.parameters
        },
        "freed_paths": None
        if result.freedom.paths is None or result.paths is None
        else {
            "modes": {
                muscle: int(free.sum())
                for muscle, free in zip(result.muscles, result.freedom.paths.free, strict=True)
                if free.any()
            },
            "prior_sd": result.freedom.paths.prior_sd,
            # Terms in parameters.csv are products of (coordinate - center) / half_range, rad or m.
            "scaling": {
                name: {"center": center, "half_range": half_range}
                for name, center, half_range in zip(
                    result.paths.coordinates,
                    np.asarray(result.paths.center),
                    np.asarray(result.paths.half_range),
                    strict=True,
                )
            },
        },
        "freed_wraps": None
        if result.freedom.wraps is None
        else {
            name: {
                quantity: {"lower": lower, "upper": upper, "prior_sd": sd}
                for quantity, lower, upper, sd in zip(result.freedom.wraps.quantities, *ends, strict=True)
                if upper > lower
            }
            for name, *ends in zip(
                result.freedom.wraps.names,
                result.freedom.wraps.lower,
                result.freedom.wraps.upper,
                result.freedom.wraps.prior_sd,
                strict=True,
            )
        },
        "freed_synergies": None
        if result.freedom.synergies is None
        else {
            "lower": -result.freedom.synergies.bound,
            "upper": result.freedom.synergies.bound,
            "prior_mean": 0.0,
            "prior_sd": result.freedom.synergies.prior_sd,
        },
        "versions": package_versions(),
        "platform": platform.platform(),
    }


def _options(options: Any) -> dict[str, Any]:
    """Convert a dataclass of options, and dataclasses within it, to dictionaries with their class name."""
    values = {field.name: getattr(options, field.name) for field in fields(options)}
    return {"class": type(options).__name__} | {
        name: _options(value) if is_dataclass(value) else value for name, value in values.items()
    }


def path_from(run: Path, target: Path) -> str:
    """Write a path relative to the run's folder, so that a run and its subject can be moved together."""
    try:
        return Path(os.path.relpath(target.resolve(), run.resolve())).as_posix()
    except ValueError:  # another drive
        return target.resolve().as_posix()


def package_versions(packages: Sequence[str] = PACKAGES) -> dict[str, str | None]:
    """Look up the installed versions of Python and packages; None if a package is not installed."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found


def versions_in_words(versions: Mapping[str, str | None] | None = None) -> str:
    """Write versions, by default the installed ones, as one line."""
    versions = package_versions() if versions is None else versions
    return ", ".join(f"{name} {number}" for name, number in versions.items() if number)


def versions_platform_and_time() -> str:
    """Write the installed versions, the platform and the present time (UTC) as one line."""
    return f"{versions_in_words()}; {platform.platform()}; {datetime.now(UTC).isoformat(timespec='seconds')}"
