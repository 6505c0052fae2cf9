"""Peaks and tests of contact forces: the content of ``contact.json``, and curves as OpenSim tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.comparison.statistics import MINIMUM_UNITS, PairedTest, paired_test, spread
from wrapjax.contact_forces.contact_result import (
    COMPARTMENTS,
    ContactResult,
    RunContact,
    compartment_name,
    peak_windows,
    peaks,
)
from wrapjax.io.storage import Storage
from wrapjax.report.provenance import package_versions

#: Version of the layout of ``contact.json``.
SCHEMA = 1


def describe_contact(result: ContactResult) -> dict[str, Any]:
    """Describe contact forces as plain numbers and strings.

    Returns
    -------
    dict
        Content of ``contact.json``: peaks in N and bodyweights with their phase in %, by run, joint and
        cycle; moments in N m that muscles leave unexplained; tests of the second run against the first.
    """
    return {
        "schema": SCHEMA,
        "subject": result.subject,
        "side": result.side,
        "mass_kg": result.mass_kg,
        "bodyweight_N": result.bodyweight,
        "kind": result.kind,
        "reason": result.reason or None,
        "joints": result.joints,
        "first_frame_phase_percent": dict(zip(result.trials, result.phase[:, 0].tolist(), strict=True)),
        "runs": [_describe_run(result, run) for run in result.runs],
        "tests": [
            {"joint": joint, "measure": measure, "test": None if test is None else asdict(test)}
            for joint, measure, test in compared_peaks(result)
        ],
        "tests_reason": tests_reason(result) or None,
        "knee_compartments": _describe_compartments(result),
        "knee_compartments_reason": result.undivided_reason or None,
        "versions": package_versions(),
    }


def _describe_run(result: ContactResult, run: RunContact) -> dict[str, Any]:
    own = run.undriven
    return {
        "run": run.label,
        "method": run.method,
        "folder": run.folder,
        "converged": run.converged,
        "undriven": {
            "treatment": own.treatment,
            "muscles": own.muscles,
            "without_force": own.without_force,
            "peak_activation": dict(zip(own.muscles, own.activation.max(axis=(1, 2)).tolist(), strict=True)),
        },
        "unexplained_moment_rms_Nm": {
            "driven_muscles": rms_by_coordinate(result, own.residual_before),
            "all_muscles": rms_by_coordinate(result, own.residual),
        },
        "joints": {
            joint: {measure: _describe_peak(result, run, joint, measure) for measure in peak_windows(joint)}
            for joint in result.joints
        },
    }


def _describe_compartments(result: ContactResult) -> dict[str, Any] | None:
    if result.condyle_distance is None:
        return None
    return {
        "condyle_distance_m": result.condyle_distance,
        "runs": {
            run.label: {
                side: {"peak": _describe_peak(result, run, compartment_name(side), "peak")}
                for side in COMPARTMENTS
            }
            for run in result.runs
        },
    }


def _describe_peak(result: ContactResult, run: RunContact, part: str, measure: str) -> dict[str, Any]:
    peak = peaks(result.curves(run, part), result.phase, peak_windows(part)[measure])
    relative = peak.force / result.bodyweight
    return {
        "mean_bodyweights": spread(relative).mean,
        "sd_bodyweights": spread(relative).sd,
        "mean_N": spread(peak.force).mean,
        "sd_N": spread(peak.force).sd,
        "mean_phase_percent": spread(peak.phase).mean,
        "sd_phase_percent": spread(peak.phase).sd,
        "trials": {
            trial: {"use": use, "bodyweights": float(own), "N": float(force), "phase_percent": float(phase)}
            for trial, use, own, force, phase in zip(
                result.trials, result.uses, relative, peak.force, peak.phase, strict=True
            )
        },
    }


def compared_peaks(result: ContactResult) -> Iterator[tuple[str, str, PairedTest | None]]:
    """Test the peaks of the second run against those of the first, paired by cycle, in bodyweights."""
    if len(result.runs) < 2:
        return
    first, second = result.runs
    for part in result.parts:
        for measure, window in peak_windows(part).items():
            first_peaks, second_peaks = (
                peaks(result.curves(run, part), result.phase, window).force / result.bodyweight
                for run in (first, second)
            )
            yield part, measure, paired_test(second_peaks, first_peaks)


def tests_reason(result: ContactResult) -> str:
    """Write why peaks were not tested; empty if they were."""
    if len(result.runs) < 2:
        return "there is only one run"
    if len(result.trials) < MINIMUM_UNITS:
        return f"fewer than {MINIMUM_UNITS} gait cycles"
    return ""


def rms_by_coordinate(
    result: ContactResult, moments: Float[np.ndarray, "trial coordinate frame"]
) -> dict[str, float]:
    """Compute the root mean square over all frames of all cycles, N m."""
    size = np.sqrt((moments**2).mean(axis=(0, 2)))
    return dict(zip(result.coordinates, size.tolist(), strict=True))


def force_table(result: ContactResult, run: RunContact, trial: int) -> Storage:
    """Tabulate one cycle's contact forces, N: ``hip_force_x``, ``_y``, ``_z`` and ``hip_force``.

    If the knee force was divided, also ``medial_knee_force`` and ``lateral_knee_force``.
    """
    columns, rows = [], []
    for place, joint in enumerate(result.joints):
        columns += [*(f"{joint}_force_{axis}" for axis in "xyz"), f"{joint}_force"]
        rows += [*run.force[trial, place], run.magnitude[trial, place]]
    for part in result.parts[len(result.joints) :]:
        columns.append(f"{part.replace(' ', '_')}_force")
        rows.append(result.curves(run, part)[trial])
    name = f"{result.kind} (N) of {result.trials[trial]} by {run.label}"
    return Storage(name, tuple(columns), result.time[trial], np.stack(rows, axis=1))


def undriven_tables(result: ContactResult, run: RunContact, trial: int) -> dict[str, Storage]:
    """Tabulate one cycle's activations and forces of muscles without an electrode, if there are any."""
    own = run.undriven
    if not own.muscles:
        return {}

    def table(title: str, curves: Float[np.ndarray, "muscle trial frame"]) -> Storage:
        name = f"{title} of {result.trials[trial]} by {run.label}"
        return Storage(name, own.muscles, result.time[trial], curves[:, trial].T)

    return {
        "undriven_activations": table("activations of muscles without EMG", own.activation),
        "undriven_forces": table("tendon forces (N) of muscles without EMG", own.force),
    }
