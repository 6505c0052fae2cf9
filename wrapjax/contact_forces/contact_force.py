"""Joint contact forces of calibrated models, by OpenSim's joint reaction or by lines of action of muscles."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.contact_forces.contact_result import (
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
from wrapjax.diagnosis.inputs.read_movement import read_recorded_movement
from wrapjax.diagnosis.inputs.recorded_movement import RecordedMovement
from wrapjax.errors import InputError, Problem
from wrapjax.evaluation.stored_run import Run, RunCurves, read_curves
from wrapjax.geometry.exact_paths.engine import GEODESIC, ExactPaths, Wrapping
from wrapjax.geometry.exact_paths.wrapped_paths import wrapped_paths
from wrapjax.geometry.paths import PathState
from wrapjax.geometry.skeleton.joint_changes import sliding_coordinates, with_sliding_joints
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.jax_setup import require_float64
from wrapjax.model.alteration import fiber_parameters
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.hill import rigid_tendon_fiber
from wrapjax.osim.joint_reaction import analyse_joint_reactions
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.undriven_muscles import UndrivenMuscles, build_undriven_muscles
from wrapjax.preprocessing.gait.gait_events import find_contacts, gait_phases
from wrapjax.renamed import renamed_arguments
from wrapjax.subject.external_loads import read_ground_loads
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

#: Short name of the joint whose force may be divided between compartments.
KNEE = "knee"
#: Treatments of muscles without an electrode.
UNDRIVEN_TREATMENTS = ("static-optimization", "left")


@dataclass(frozen=True)
class Contact:
    """Joint contact forces of one leg by one or two calibrations.

    Parameters
    ----------
    subject
        Subject of the calibrations.
    result
        Contact forces by run, with muscles without an electrode.
    """

    subject: Subject
    result: ContactResult

    @property
    def converged(self) -> bool:
        """Whether all calibrations converged."""
        return all(run.converged for run in self.result.runs)

    def to_dataset(self) -> Dataset:
        """Return all curves as an `xarray.Dataset` with units."""
        from wrapjax.report.labelled.arrays import contact_dataset

        return contact_dataset(self.result)

    def summary(self) -> dict[str, Any]:
        """Return the content of ``contact.json``."""
        from wrapjax.report.contact_forces.summary import describe_contact

        return describe_contact(self.result)

    def plot_magnitudes(self) -> Figure:
        """Draw the magnitude of the contact force in each joint over the gait cycle, N."""
        from wrapjax.report.contact_forces.page import magnitude_figure

        return magnitude_figure(self.result)

    def plot_components(self) -> Figure:
        """Draw the components of the contact forces along the axes of the proximal bones, N."""
        from wrapjax.report.contact_forces.page import component_figure

        return component_figure(self.result)

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``contact.json``, curves and ``report.html`` into a new folder."""
        from wrapjax.report.contact_forces.page import write_contact

        write_contact(self.result, Path(folder), force=force)


@renamed_arguments(tell="log")
def contact(
    run: Run | str | Path,
    other: Run | str | Path | None = None,
    *,
    subject: Subject | str | Path | None = None,
    undriven: str = UNDRIVEN_TREATMENTS[0],
    condyle_distance: float | None = None,
    log: Callable[[str], None] = lambda line: None,
) -> Contact:
    """Compute the joint contact forces of a leg with the muscle forces of one or two calibrations.

    If ground forces, external loads and the motion of all bodies distal to the joints were recorded, the
    contact forces are OpenSim's joint reactions: on the nominal model for NGA, on the personalised model for
    PGA. Otherwise they are the contribution of muscles alone, from their lines of action, and are labelled as
    such.

    Parameters
    ----------
    run
        Run from `load_run`, or its folder; method NGA or PGA.
    other
        Second run of the same subject, tested against the first cycle by cycle.
    subject
        Subject or subject folder, if it has been moved since the calibration.
    undriven
        Treatment of muscles without an electrode: ``static-optimization``, they balance the remaining joint
        moments with least squared activations (`wrapjax.contact_forces.static_optimization.share_moments`);
        ``left``, they have no force.
    condyle_distance
        Distance between the medial and lateral contact points of the knee, m, by which the knee's force is
        divided (`knee_compartments`); None to leave it undivided.
    log
        Function that takes a line of progress.

    Returns
    -------
    Contact
        Contact forces of each cycle, N.

    Raises
    ------
    InputError
        If a folder is not that of a run or lacks a file, its subject is not found, the runs are of different
        subjects, the method is SGA or LSGA (whose polynomials do not define where muscles run), or the
        condyle distance is implausible.
    ValueError
        If the treatment is unknown.
    RuntimeError
        If JAX is not in 64-bit mode.
    """
    require_float64()
    if undriven not in UNDRIVEN_TREATMENTS:
        raise ValueError(f"unknown treatment '{undriven}': expected one of {', '.join(UNDRIVEN_TREATMENTS)}")
    _check_distance(condyle_distance)
    runs = [read_curves(run, subject)]
    if other is not None:
        runs.append(read_curves(other, subject))
        _check_same_subject(*runs)
    models = [_model_file(entry) for entry in runs]
    leg = runs[0].subject
    joints = _joints(models[0], leg.trials.moment_coordinates)
    gait, reason = read_recorded_movement(leg)
    undivided_reason = _undivided_reason(
        joints, whole_force=gait is not None, requested=condyle_distance is not None
    )
    contacts = []
    for entry, model_file, label in zip(runs, models, _labels(runs), strict=True):
        log(f"{label}: muscles without an electrode")
        others = _undriven(entry, model_file, undriven)
        log(f"{label}: {'joint reactions by OpenSim' if gait else 'lines of action of the muscles'}")
        muscles = (*entry.run.muscles, *others.muscles)
        force = np.concatenate([entry.force, others.force])
        compartments = None
        if gait is None:
            contact_force = _muscle_contribution(leg, model_file, tuple(joints.values()), muscles, force)
        else:
            contact_force, on_child = _joint_reactions(
                gait, model_file, tuple(joints.values()), muscles, force
            )
            if condyle_distance is not None and not undivided_reason:
                on_tibia = on_child[:, list(joints).index(KNEE)]
                compartments = knee_compartments(on_tibia, condyle_distance, leg.side)
        run_folder = entry.run.folder.name
        contacts.append(
            RunContact(
                label,
                entry.run.method,
                run_folder,
                entry.run.converged,
                others,
                contact_force,
                compartments,
            )
        )
    trials = leg.trials
    return Contact(
        leg,
        ContactResult(
            subject=leg.name,
            side=leg.side,
            mass_kg=leg.mass_kg,
            kind=MUSCLE_SHARE if gait is None else JOINT_REACTION,
            reason=reason,
            joints=joints,
            coordinates=trials.moment_coordinates,
            trials=trials.names,
            uses=trials.uses,
            time=trials.time,
            phase=_phase(leg, () if gait is None else gait.loaded_bodies),
            runs=tuple(contacts),
            condyle_distance=None if undivided_reason else condyle_distance,
            undivided_reason=undivided_reason,
        ),
    )


def _check_distance(distance: float | None) -> None:
    """Raise an error if the distance between the contact points is implausible."""
    if distance is not None and not MIN_CONDYLE_DISTANCE <= distance <= MAX_CONDYLE_DISTANCE:
        expected = f"{MIN_CONDYLE_DISTANCE:g} to {MAX_CONDYLE_DISTANCE:g} m"
        message = f"{distance:g} m apart, where {expected} were expected"
        raise InputError(Problem("the condyles of a knee", message))


def _undivided_reason(joints: Collection[str], *, whole_force: bool, requested: bool) -> str:
    """Return the reason why the knee's force is not divided; empty if it is."""
    if KNEE not in joints:
        return "the moments of no knee were measured"
    if not whole_force:
        return (
            "only the contribution of the muscles to the knee's force is known, not its moment in the "
            "frontal plane"
        )
    if not requested:
        return (
            "the model's knee is one joint, and does not define how its force divides between the medial and "
            "the lateral side; give the distance between its contact points (--condyle-distance)"
        )
    return ""


def _phase(subject: Subject, loaded: Sequence[str]) -> Float[np.ndarray, "trial frame"]:
    """Compute the phase of all frames (%) from the strikes of the leg's foot."""
    trials = subject.trials
    strikes = {trial.name: np.zeros(0) for trial in subject.recordings}
    for trial in subject.recordings if loaded else ():
        loads = read_ground_loads(trial)
        rows = [row for row, body in enumerate(loads.bodies) if body in loaded]
        strikes[trial.name] = find_contacts(loads.time, loads.wrench[rows, 4].sum(axis=0)).strikes
    return gait_phases(trials.time, [strikes[name] for name in trials.recordings])


def _check_same_subject(one: RunCurves, other: RunCurves) -> None:
    if one.subject.folder.resolve() != other.subject.folder.resolve():
        message = f"was made from {other.subject.folder}, where {one.subject.folder} was expected"
        raise InputError(Problem(str(other.run.folder), message, hint="compare runs of one subject"))


def _labels(runs: Sequence[RunCurves]) -> list[str]:
    """Label runs by method, with number and folder name where the methods are the same."""
    methods = [entry.run.method for entry in runs]
    if len(set(methods)) == len(methods):
        return methods
    return [
        f"{entry.run.method} {number} ({entry.run.folder.name})" for number, entry in enumerate(runs, start=1)
    ]


def _model_file(entry: RunCurves) -> Path:
    """Return the model file with the muscle paths of a run."""
    from wrapjax.report.calibration.run_page import PERSONALISED_MODEL

    run = entry.run
    if run.method == "PGA":
        file = run.folder / PERSONALISED_MODEL
        if not file.is_file():
            message = "is missing; the muscle paths of PGA are in the model that it wrote"
            raise InputError(Problem(str(file), message))
        return file
    if run.method in ("SGA", "LSGA"):
        message = (
            f"was made by {run.method}, which adjusts polynomials: they define the lengths of muscles, not "
            f"where"
        )
        raise InputError(Problem(str(run.folder), f"{message} they run", hint="use NGA or PGA"))
    return entry.subject.model_file


def _joints(model_file: Path, coordinates: Sequence[str]) -> dict[str, str]:
    """Return the joints with measured moments by short name (``hip``), in the order of the coordinates."""
    owners = {name: joint.name for joint in describe_model(model_file).joints for name in joint.coordinates}
    joints: dict[str, str] = {}
    for coordinate in coordinates:
        joint, short_name = owners[coordinate], coordinate.split("_")[0]
        if joint not in joints.values():
            joints[short_name if short_name not in joints else joint] = joint
    return joints


def _undriven(entry: RunCurves, model_file: Path, treatment: str) -> Undriven:
    """Compute forces of muscles without an electrode by static optimization, or leave them without force."""
    missing = entry.measured - entry.modelled
    trials, coordinates, frames = missing.shape
    # Muscles driven by synergies have calibrated forces.
    undriven_muscles = tuple(name for name in entry.subject.undriven_muscles if name not in entry.run.muscles)
    parameters = entry.subject.undriven_parameters
    subject = replace(
        entry.subject,
        undriven_muscles=undriven_muscles,
        undriven_parameters=None if parameters is None else parameters.select(undriven_muscles),
    )
    empty = np.zeros((0, trials, frames))
    left = Undriven("left", (), undriven_muscles, empty, empty, missing, missing)
    others = build_undriven_muscles(subject, entry.run.curves, model_file)[0] if treatment != "left" else None
    if others is None:
        return left
    active = _active_forces(others)
    arm = np.asarray(others.path.moment_arm)
    count = len(others.names)
    # Trials are concatenated, because every frame is optimized separately.
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
        without_force=tuple(name for name in undriven_muscles if name not in others.names),
        activation=activation,
        force=activation * active,
        residual=np.moveaxis(shared.residual.reshape(coordinates, trials, frames), 0, 1),
    )


def _active_forces(others: UndrivenMuscles) -> Float[np.ndarray, "muscle trial frame"]:
    """Compute active tendon forces at full activation (N) with parameters that were not calibrated.

    Passive forces are omitted: slack lengths of these muscles are not calibrated, and with rigid tendons an
    error of a few millimetres causes hundreds of newtons.
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


def _joint_reactions(
    gait: RecordedMovement,
    model_file: Path,
    joints: Sequence[str],
    muscles: Sequence[str],
    force: Float[np.ndarray, "muscle trial frame"],
) -> tuple[Float[np.ndarray, "trial joint 3 frame"], Float[np.ndarray, "trial joint 6 frame"]]:
    """Compute OpenSim's joint reactions: forces on the proximal, moments and forces on the distal bodies."""
    reactions = analyse_joint_reactions(
        model_file,
        joints,
        gait.motion,
        gait.loaded_bodies,
        gait.wrenches,
        muscles,
        force.reshape(len(muscles), -1),
    )

    def by_trial(values: Float[np.ndarray, "joint _ pose"]) -> Float[np.ndarray, "trial joint _ frame"]:
        return np.moveaxis(values.reshape(*values.shape[:2], *gait.time.shape), 2, 0)

    return by_trial(reactions.on_parent), by_trial(reactions.on_child)


def _muscle_contribution(
    subject: Subject,
    model_file: Path,
    joints: Sequence[str],
    muscles: Sequence[str],
    force: Float[np.ndarray, "muscle trial frame"],
) -> Float[np.ndarray, "trial joint 3 frame"]:
    """Compute the contribution of muscles to the joint contact forces from their lines of action."""
    model, trials = describe_model(model_file), subject.trials
    spanned = {name for muscle in muscles for name in model.spanned_by(muscle)}
    coordinates = [name for name in trials.coordinates if name in spanned]
    rows = [trials.coordinates.index(name) for name in coordinates]
    lines = lines_of_action(model, muscles, joints, coordinates, trials.angles[:, rows])
    return sum_muscle_forces(lines, force)


def lines_of_action(
    model: ModelDescription,
    muscles: Sequence[str],
    joints: Sequence[str],
    coordinates: Sequence[str],
    angles: Float[np.ndarray, "trial coordinate frame"],
    wrapping: Wrapping = GEODESIC,
) -> Float[np.ndarray, "muscle joint 3 trial frame"]:
    """Compute the force on each joint per unit force of each muscle, without OpenSim or ground forces.

    Each joint gets translational coordinates. The derivative of a muscle's length with respect to these is
    its line of action across the joint, just as its moment arm is the derivative with respect to a rotation.

    Parameters
    ----------
    model
        Model from `wrapjax.osim.model.describe_model`.
    muscles, joints
        Names of muscles and joints.
    coordinates
        Names of the recorded coordinates.
    angles
        Recorded angles, rad (m for translations).
    wrapping
        Wrapping of the exact engine: shortest paths, or parity with OpenSim.

    Returns
    -------
    array
        Force of the distal on the proximal body per unit muscle force (N/N), along x, y and z of the proximal
        body. Zero for a muscle that does not cross the joint; otherwise the sum of one unit vector for each
        crossing.

    Raises
    ------
    InputError
        If a path or a joint has a feature that the exact engine does not support.
    """
    slides = tuple(name for joint in joints for name in sliding_coordinates(joint))
    engine = ExactPaths(with_sliding_joints(model, joints), muscles, (*coordinates, *slides))
    trials, _, frames = angles.shape
    zeros = np.zeros((trials, len(slides), frames))
    poses = np.concatenate([angles, zeros], axis=1)
    path = wrapped_paths(engine, poses, np.zeros_like(poses), slides, (), wrapping)[0].nominal
    lines = np.asarray(path.moment_arm).reshape(len(muscles), trials, len(joints), 3, frames)
    return np.moveaxis(lines, 1, 3)


def sum_muscle_forces(
    lines: Float[np.ndarray, "muscle joint 3 trial frame"], force: Float[np.ndarray, "muscle trial frame"]
) -> Float[np.ndarray, "trial joint 3 frame"]:
    """Sum the forces of all muscles on each joint.

    This would be the joint's contact force if bodies had no mass and no external forces.

    Parameters
    ----------
    lines
        Lines of action from `lines_of_action`, N/N.
    force
        Tendon forces, N.

    Returns
    -------
    array
        Force of the distal on the proximal body by muscles, N, along x, y and z of the proximal body.
    """
    return np.einsum("mjxtf,mtf->tjxf", lines, force)
