"""What a calibration was made from and with: the content of ``settings.json``."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from wrapjax.calibrate import CalibrationResult
from wrapjax.model import QUANTITIES
from wrapjax.subject import Subject

PACKAGES = ("wrapjax", "jax", "jaxlib", "equinox", "numpy", "scipy", "opensim", "matplotlib")


def describe_settings(subject: Subject, result: CalibrationResult) -> dict[str, Any]:
    """Describe what a calibration was made from and with.

    Returns
    -------
    dict
        Subject, drive of the muscles, trials, what was free with its bounds and priors (lists in the
        order of ``muscles``, SI units; no prior is an infinite deviation), versions and platform.
    """
    trials = subject.trials
    driven = list(zip(subject.muscles.names, subject.muscle_channels, strict=True))
    return {
        "schema": 1,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "subject": {
            "name": subject.name,
            "folder": subject.folder,
            "model_file": subject.model_file,
            "mass_kg": subject.mass_kg,
            "side": subject.side,
            "paretic": subject.paretic,
            "other_leg": subject.other_leg,
        },
        "method": result.method,
        "curves": result.curves,
        "solver": asdict(result.solver) | {"method": type(result.solver.inner).__name__},
        "starts": [outcome.seed for outcome in result.outcomes],
        "coordinates": result.coordinates,
        "channels": {
            channel: [name for name, driver in driven if driver == place]
            for place, channel in enumerate(trials.channels)
        },
        "undriven_muscles": subject.undriven_muscles,
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
        if result.freedom.paths is None
        else {
            "muscles": [
                muscle
                for muscle, free in zip(result.muscles, result.freedom.paths.muscles, strict=True)
                if free
            ],
            "coefficients": int(result.freedom.paths.free.sum()),
            "allowable_change": result.freedom.paths.prior_sd,
        },
        "versions": package_versions(),
        "platform": platform.platform(),
    }


def package_versions(packages: Sequence[str] = PACKAGES) -> dict[str, str | None]:
    """Look up installed versions, Python's first; None for what is not installed."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found
