"""``contact``: what joints bear, by OpenSim's joint reaction or by the muscles' lines of action."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.contact_forces.gait_phase import gait_phases
from wrapjax.contact_forces.lines_of_action import lines_of_action, sum_muscle_forces
from wrapjax.contact_forces.result import (
    JOINT_REACTION,
    MAX_CONDYLE_DISTANCE,
    MIN_CONDYLE_DISTANCE,
    MUSCLE_SHARE,
    ContactResult,
    RunContact,
    Undriven,
    knee_compartments,
)
from wrapjax.contact_forces.static_optimization import share_moments
from wrapjax.diagnosis.inverse_dynamics.measured_changes import recorded_walk
from wrapjax.diagnosis.inverse_dynamics.recorded_walk import Walk
from wrapjax.errors import InputError, Problem
from wrapjax.evaluation.stored_run import Run, RunCurves, read_curves
from wrapjax.geometry.paths import PathState
from wrapjax.jax_setup import require_float64
from wrapjax.model.alteration import fiber_parameters
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.hill import rigid_tendon_fiber
from wrapjax.osim.joint_reaction import analyse_joint_reactions
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.undriven_muscles import UndrivenMuscles, build_undriven_muscles
from wrapjax.preprocessing.gait_events import find_contacts
from wrapjax.subject.external_loads import read_ground_loads
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from xarray import Dataset

#: The joint whose force may be divided, as `_joints` calls it.
KNEE = "knee"
#: What may be made of muscles without an electrode.
UNDRIVEN_TREATMENTS = ("static-optimization", "left")


@dataclass(frozen=True)
class Contact:
    """Contact forces of one leg's joints, by one or two runs."""

    subject: Subject
    result: ContactResult

    @property
    def converged(self) -> bool:
        """Whether the calibrations had, so that forces are final."""
        return all(run.converged for run in self.result.runs)

    @property
    def dataset(self) -> Dataset:
        """All curves as an `xarray.Dataset`, every variable with its unit."""
        from wrapjax.report.labelled_arrays import contact_dataset

        return contact_dataset(self.result)

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``contact.json``, curves and ``report.html``."""
        from wrapjax.report.contact_page import write_contact

        write_contact(self.result, Path(folder), force=force)


def contact(
    run: Run | str | Path,
    other: Run | str | Path | None = None,
    *,
    subject: Subject | str | Path | None = None,
    undriven: str = UNDRIVEN_TREATMENTS[0],
    condyle_distance: float | None = None,
    log: Callable[[str], None] = lambda line: None,
) -> Contact:
    """Say what the joints of a leg bear with the muscle forces of a finished calibration.

    Where ground forces, external loads and the motion of all bodies below the joints were recorded, that is
    OpenSim's joint reaction: on the nominal model for NGA, on the personalised one for PGA. Elsewhere it is
    the muscles' share alone, by their lines of action, which is not the whole force and is labelled so.

    Parameters
    ----------
    run, other
        From `load_run`, or folders that `Calibration.save` wrote, of the same subject: NGA and PGA as a rule.
        Two are tested against each other, cycle by cycle.
    subject
        The subject, or its folder, where that is no longer where it was.
    undriven
        What is made of muscles without an electrode: ``static-optimization``, they close the joint moments
        with least effort (`wrapjax.contact_forces.static_optimization.share_moments`), or ``left``, no force.
    condyle_distance
        Between the points where the medial and the lateral condyle touch the tibia, m: divides the knee's
        force between the two (`knee_compartments`), which no model with one knee joint does by itself.
    tell
        Called with a line at each step.

    Returns
    -------
    Contact
        In N, per cycle.

    Raises
    ------
    InputError
        If a folder is no run's, lacks a file, its subject is not found, or its method says nothing of
        where muscles run (SGA and LSGA adjust polynomials); if no knee has condyles so far apart.
    """
    require_float64()
    if undriven not in UNDRIVEN_TREATMENTS:
        raise ValueError(f"unknown treatment '{undriven}': expected one of {', '.join(UNDRIVEN_TREATMENTS)}")
    _check_distance(condyle_distance)
    runs = [read_curves(run, subject)]
    if other is not None:
        runs.append(read_curves(other, subject))
        _check_alike(*runs)
    models = [_model_of(own) for own in runs]
    own = runs[0].subject
    joints = _joints(models[0], own.trials.moment_coordinates)
    walk, reason = recorded_walk(own)
    undivided_reason = _undivided(joints, whole=walk is not None, asked=condyle_distance is not None)
    found = []
    for entry, model_file, label in zip(runs, models, _labels(runs), strict=True):
        log(f"{label}: muscles without an electrode")
        others = _undriven(entry, model_file, undriven)
        log(f"{label}: {'joint reactions by OpenSim' if walk else 'lines of action of the muscles'}")
        muscles = (*entry.run.muscles, *others.muscles)
        force = np.concatenate([entry.force, others.force])
        compartments = None
        if walk is None:
            pressed = _share(own, model_file, tuple(joints.values()), muscles, force)
        else:
            pressed, on_child = _reactions(walk, model_file, tuple(joints.values()), muscles, force)
            if condyle_distance is not None and not undivided_reason:
                on_tibia = on_child[:, list(joints).index(KNEE)]
                compartments = knee_compartments(on_tibia, condyle_distance, own.side)
        found.append(_run_contact(label, entry.run, others, pressed, compartments))
    trials = own.trials
    return Contact(
        own,
        ContactResult(
            subject=own.name,
            side=own.side,
            mass_kg=own.mass_kg,
            kind=MUSCLE_SHARE if walk is None else JOINT_REACTION,
            reason=reason,
            joints=joints,
            coordinates=trials.moment_coordinates,
            trials=trials.names,
            uses=trials.uses,
            time=trials.time,
            phase=_phase(own, () if walk is None else walk.loaded),
            runs=tuple(found),
            condyle_distance=None if undivided_reason else condyle_distance,
            undivided_reason=undivided_reason,
        ),
    )


def _check_distance(distance: float | None) -> None:
    if distance is not None and not MIN_CONDYLE_DISTANCE <= distance <= MAX_CONDYLE_DISTANCE:
        message = f"{distance:g} m apart, where {MIN_CONDYLE_DISTANCE:g} to {MAX_CONDYLE_DISTANCE:g} m were expected"
        raise InputError(Problem("the condyles of a knee", message))


def _undivided(joints: Collection[str], *, whole: bool, asked: bool) -> str:
    """Say why the knee's force is not divided; empty where it is."""
    if KNEE not in joints:
        return "the moments of no knee were measured"
    if not whole:
        return "only the muscles' share of the knee's force is known, not what turns it in the frontal plane"
    if not asked:
        return (
            "the model's knee is one joint, and does not say how its force divides between the medial and "
            "the lateral side; give the distance between the points where its condyles touch "
            "(--condyle-distance)"
        )
    return ""


def _phase(subject: Subject, loaded: Sequence[str]) -> Float[np.ndarray, "trial frame"]:
    """Count frames from strikes of this leg's foot, %."""
    trials = subject.trials
    strikes = {trial.name: np.zeros(0) for trial in subject.recordings}
    for trial in subject.recordings if loaded else ():
        loads = read_ground_loads(trial)
        rows = [row for row, body in enumerate(loads.bodies) if body in loaded]
        strikes[trial.name] = find_contacts(loads.time, loads.wrench[rows, 4].sum(axis=0)).strikes
    return gait_phases(trials.time, [strikes[name] for name in trials.recordings])


def _check_alike(one: RunCurves, other: RunCurves) -> None:
    if one.subject.folder.resolve() != other.subject.folder.resolve():
        message = f"was made from {other.subject.folder}, where {one.subject.folder} was expected"
        raise InputError(Problem(str(other.run.folder), message, hint="compare runs of one subject"))


def _labels(runs: Sequence[RunCurves]) -> list[str]:
    """Call runs by their methods, and by their folders too where those are the same."""
    methods = [entry.run.method for entry in runs]
    if len(set(methods)) == len(methods):
        return methods
    return [
        f"{entry.run.method} {number} ({entry.run.folder.name})" for number, entry in enumerate(runs, start=1)
    ]


def _run_contact(
    label: str,
    run: Run,
    undriven: Undriven,
    force: Float[np.ndarray, "trial joint 3 frame"],
    compartments: Float[np.ndarray, "trial 2 frame"] | None,
) -> RunContact:
    return RunContact(label, run.method, run.folder.name, run.converged, undriven, force, compartments)


def _model_of(entry: RunCurves) -> Path:
    """Find the model in which a run's muscles run."""
    from wrapjax.report.run_folder import PERSONALISED_MODEL

    run = entry.run
    if run.method == "PGA":
        file = run.folder / PERSONALISED_MODEL
        if not file.is_file():
            message = "is not there; where muscles run after PGA is said by the model that it wrote"
            raise InputError(Problem(str(file), message))
        return file
    if run.method in ("SGA", "LSGA"):
        message = (
            f"was made by {run.method}, which adjusts polynomials: they say how long muscles are, not where"
        )
        raise InputError(Problem(str(run.folder), f"{message} they pull", hint="use NGA or PGA"))
    return entry.subject.model_file


def _joints(model_file: Path, coordinates: Sequence[str]) -> dict[str, str]:
    """Name the joints that moments were measured about, plainly (``hip``), proximal ones first as a rule."""
    owners = {name: joint.name for joint in describe_model(model_file).joints for name in joint.coordinates}
    found: dict[str, str] = {}
    for coordinate in coordinates:
        joint, plain = owners[coordinate], coordinate.split("_")[0]
        if joint not in found.values():
            found[plain if plain not in found else joint] = joint
    return found


def _undriven(entry: RunCurves, model_file: Path, treatment: str) -> Undriven:
    """Give muscles without an electrode the forces that close the moments best, or none."""
    missing = entry.measured - entry.modelled
    trials, coordinates, frames = missing.shape
    # Muscles that synergies drove have their calibrated forces.
    all_of_them = tuple(name for name in entry.subject.undriven_muscles if name not in entry.run.muscles)
    parameters = entry.subject.undriven_parameters
    subject = replace(
        entry.subject,
        undriven_muscles=all_of_them,
        undriven_parameters=None if parameters is None else parameters.select(all_of_them),
    )
    nothing = np.zeros((0, trials, frames))
    left = Undriven("left", (), all_of_them, nothing, nothing, missing, missing)
    others = build_undriven_muscles(subject, entry.run.curves, model_file)[0] if treatment != "left" else None
    if others is None:
        return left
    active = _strengths(others)
    arm = np.asarray(others.path.moment_arm)
    count = len(others.names)
    # One row of frames: every frame is a question of its own.
    shared = share_moments(
        np.moveaxis(missing, 1, 0).reshape(coordinates, -1),
        np.moveaxis(arm, 2, 1).reshape(count, coordinates, -1),
        active.reshape(count, -1),
    )
    activation = shared.activation.reshape(count, trials, frames)
    return replace(
        left,
        treatment=treatment,
        muscles=others.names,
        without_force=tuple(name for name in all_of_them if name not in others.names),
        activation=activation,
        force=activation * active,
        residual=np.moveaxis(shared.residual.reshape(coordinates, trials, frames), 0, 1),
    )


def _strengths(others: UndrivenMuscles) -> Float[np.ndarray, "muscle trial frame"]:
    """Forces along the tendon at full activation, N, by parameters that nobody calibrated.

    Passive forces are left out: nobody fitted these muscles' slack lengths, and with tendons that do not
    stretch a few millimetres too little make hundreds of newtons.
    """

    def of_one(path: PathState, parameters: ModelParameters) -> Array:
        fiber = rigid_tendon_fiber(
            others.curves,
            jnp.ones_like(path.length),
            path.length,
            path.velocity,
            **fiber_parameters(parameters),
        )
        return fiber.active_force

    return np.maximum(np.asarray(jax.vmap(of_one)(others.path, others.parameters)), 0.0)


def _reactions(
    walk: Walk,
    model_file: Path,
    joints: Sequence[str],
    muscles: Sequence[str],
    force: Float[np.ndarray, "muscle trial frame"],
) -> tuple[Float[np.ndarray, "trial joint 3 frame"], Float[np.ndarray, "trial joint 6 frame"]]:
    """Force on the proximal bodies, and moment and force on the distal ones."""
    found = analyse_joint_reactions(
        model_file, joints, walk.motion, walk.loaded, walk.wrench, muscles, force.reshape(len(muscles), -1)
    )

    def by_trial(reactions: Float[np.ndarray, "joint _ pose"]) -> Float[np.ndarray, "trial joint _ frame"]:
        return np.moveaxis(reactions.reshape(*reactions.shape[:2], *walk.time.shape), 2, 0)

    return by_trial(found.on_parent), by_trial(found.on_child)


def _share(
    subject: Subject,
    model_file: Path,
    joints: Sequence[str],
    muscles: Sequence[str],
    force: Float[np.ndarray, "muscle trial frame"],
) -> Float[np.ndarray, "trial joint 3 frame"]:
    model, trials = describe_model(model_file), subject.trials
    spanned = {name for muscle in muscles for name in model.spanned_by(muscle)}
    coordinates = [name for name in trials.coordinates if name in spanned]
    rows = [trials.coordinates.index(name) for name in coordinates]
    lines = lines_of_action(model, muscles, joints, coordinates, trials.angles[:, rows])
    return sum_muscle_forces(lines, force)
