"""Recover known joints from markers that OpenSim places, without and with movement of skin.

Run it as ``python -m validation.joints.recovery --people 50`` (recorded model and running: ``WRAPJAX_DATA``).
Each virtual person is the scaled gait2392 of the recorded runner with other joints of the right leg: centres
up to 20 mm off along each axis, hinge axes up to 10 degrees, and body scales up to 10 %. Motions are part of
the recorded running and one of each joint alone. OpenSim computes the markers of the true model.

Skin moves each marker on its body by 4.5 mm (root mean square), in proportion to the angles of the joints at
the body (continuous and in phase, the same per angle in all trials; of the size of Reinbolt et al. 2005,
J Biomech 38), and by a slow sinusoid of about half that size. ``--curvature`` adds movement in proportion to
squared angles, which the estimation allows for, too. ``--saturating`` lets skin follow large angles less than
small ones, which the estimation does not know of. ``--cameras-mm`` adds noise.

Errors are those of the joint's centre against the body's markers: the estimated body is laid on the true one
by the markers that it carries, in the parent and in the child body where these carry three or more; of a
hinge, the distance from the true axis, and the angle between the axes.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.marker_model import build_marker_model
from wrapjax.geometry.skeleton.model_description import Joint, ModelDescription
from wrapjax.io.storage import read_storage
from wrapjax.jax_setup import set_up_jax
from wrapjax.joints.changed_skeleton import skeleton_change
from wrapjax.joints.freed_parameters import (
    FreedParameter,
    PriorWidths,
    frame_parameters,
    scale_parameters,
)
from wrapjax.joints.personalisation import personalize_joints
from wrapjax.joints.result import JointPersonalisation
from wrapjax.joints.settings import JointSettings, MarkerTrial
from wrapjax.osim.body_frames import pose_bodies
from wrapjax.osim.model import describe_model
from wrapjax.osim.personalised_joints import JointChanges, write_model_with_joints
from wrapjax.preprocessing.files.markers import Markers, write_trc

JOINTS = ("hip_r", "knee_r", "ankle_r")
HINGES = ("knee_r", "ankle_r")
BODIES = ("pelvis", "femur_r", "tibia_r", "calcn_r")
#: Largest true changes: m, rad, share.
CENTRE, AXIS, SCALE = 0.02, np.radians(10.0), 0.1
#: Root mean square movement of skin, m, and size of its slow part against that of one angle.
SKIN, SLOW = 0.0045, 0.5
#: Frames a second.
RATE = 100.0


def freed() -> list[FreedParameter]:
    """Freed values: frames of the joints, and one scale for each body."""
    widths = PriorWidths()
    values = []
    for joint in JOINTS:
        for side in ("parent", "child"):
            values += frame_parameters(joint, f"{side}_translation", range(3), widths)
            if joint in HINGES:
                values += frame_parameters(joint, f"{side}_orientation", (0, 1), widths)
    for body in BODIES:
        values += scale_parameters(body, widths, per_axis=False)
    return values


def motions(folder: Path, coordinates: list[str]) -> dict[str, Float[np.ndarray, "frame coordinate"]]:
    """Motions by name, rad and m: running, then hip, knee and ankle alone."""
    table = read_storage(folder / "lab" / "ik.sto")
    factor = np.pi / 180.0 if table.in_degrees else 1.0
    running = np.zeros((75, len(coordinates)))
    rows = slice(100, 175)
    for column, name in enumerate(coordinates):
        values = table.values[rows, table.columns.index(name)] if name in table.columns else np.zeros(75)
        running[:, column] = values if name.startswith("pelvis_t") and name[-2] == "t" else factor * values
    phase = np.linspace(0.0, 4.0 * np.pi, 100)
    alone = {
        "hip": {
            "hip_flexion_r": 0.4 + 0.5 * np.sin(phase),
            "hip_adduction_r": 0.35 * np.cos(phase),
            "hip_rotation_r": 0.3 * np.sin(0.5 * phase),
        },
        "knee": {"knee_angle_r": -0.8 + 0.7 * np.sin(phase), "hip_flexion_r": 0.3 + 0.1 * np.sin(phase)},
        "ankle": {"ankle_angle_r": 0.45 * np.sin(phase), "knee_angle_r": -0.3 + 0.1 * np.cos(phase)},
    }
    made = {"running": running}
    for name, moved in alone.items():
        values = np.zeros((phase.size, len(coordinates)))
        values[:, coordinates.index("pelvis_ty")] = 0.95
        for coordinate, path in moved.items():
            values[:, coordinates.index(coordinate)] = path
        made[name] = values
    return made


def write_person(
    model: Path, true_model: Path, truth: Float[np.ndarray, " parameter"], parameters: list[FreedParameter]
) -> None:
    """Write the true model: the starting one with changed scales and frames."""
    description = describe_model(model)
    names = tuple(marker.name for marker in description.markers)
    skeleton = build_marker_model(description, [entry.name for entry in description.coordinates], names)
    change = skeleton_change(description, skeleton, names, parameters)
    changed, structure = change.apply(skeleton, truth).skeleton, skeleton.structure
    scales = 1.0 + np.asarray(change.scales @ truth)
    frames = {}
    for name in JOINTS:
        row = structure.joints.index(name)
        frames[name] = (
            (np.asarray(changed.parent_rotation)[row], np.asarray(changed.parent_origin)[row]),
            (np.asarray(changed.child_rotation)[row], np.asarray(changed.child_origin)[row]),
        )
    factors = {body: scales[structure.bodies.index(body)] for body in BODIES}
    write_model_with_joints(model, true_model, JointChanges(scales=factors, frames=frames))


def moved_skin(
    motion_of: dict[str, Float[np.ndarray, "frame coordinate"]],
    gains: Float[np.ndarray, "marker 3 coordinate"],
    skin: float,
    rng: np.random.Generator,
    curvature: float = 0.0,
    saturating: bool = False,
) -> dict[str, Float[np.ndarray, "frame marker 3"]]:
    """Movements of markers on their bodies, m, by trial: the same per angle in all trials.

    With a curvature they also move in proportion to the squared angles, with other random amplitudes. Skin
    that saturates moves with the hyperbolic tangent of the standardised angle.
    """
    joined = np.concatenate(list(motion_of.values()))
    mean, spread = joined.mean(axis=0), joined.std(axis=0)
    bent = curvature * rng.permutation(gains, axis=1)
    moved = {}
    for name, motion in motion_of.items():
        angles = (motion - mean) / np.where(spread > np.radians(1.0), spread, np.inf)
        phase = rng.uniform(0.0, 2.0 * np.pi, (1, len(gains), 3))
        time = np.arange(len(motion))[:, None, None] / RATE
        slow = np.sin(2.0 * np.pi * 0.7 * time + phase) * rng.normal(size=(1, len(gains), 3))
        followed = np.tanh(angles) if saturating else angles
        moved[name] = np.einsum("mkc,fc->fmk", gains, followed) + SLOW * slow
        moved[name] += np.einsum("mkc,fc->fmk", bent, angles**2 - 1.0)
    size = np.sqrt(np.mean(np.sum(np.concatenate(list(moved.values())) ** 2, axis=-1)))
    return {name: skin / size * values for name, values in moved.items()}


def recorded(
    true_model: Path,
    coordinates: list[str],
    motion: Float[np.ndarray, "frame coordinate"],
    names: tuple[str, ...],
    moved: Float[np.ndarray, "frame marker 3"],
) -> Markers:
    """Markers of a motion by OpenSim, moved with the skin on their bodies."""
    frames = pose_bodies(true_model, coordinates, motion)
    carriers = {marker.name: marker.body for marker in describe_model(true_model).markers}
    order = [frames.markers.index(name) for name in names]
    rotation = frames.rotation[:, [frames.bodies.index(carriers[name]) for name in names]]
    positions = frames.positions[:, order] + np.einsum("fmij,fmj->fmi", rotation, moved)
    return Markers(names, np.arange(len(motion)) / RATE, np.moveaxis(positions, 0, 1))


def skin_gains(
    description: ModelDescription, names: tuple[str, ...], coordinates: list[str], rng: np.random.Generator
) -> Float[np.ndarray, "marker 3 coordinate"]:
    """Random movements of each marker per standardised angle of the joints at its body."""
    gains = rng.normal(size=(len(names), 3, len(coordinates)))
    carriers = {marker.name: marker.body for marker in description.markers}
    for row, name in enumerate(names):
        near = {
            coordinate
            for joint in description.joints
            if carriers[name] in (joint.parent_body, joint.child_body) and joint.name in JOINTS
            for coordinate in joint.coordinates
        }
        gains[row] *= [coordinate in near for coordinate in coordinates]
    return gains


def errors(found: ModelDescription, truth: ModelDescription) -> dict[str, tuple[float, float]]:
    """Distance of centres (m) and angle between axes (rad), the mean of parent and child body, by joint."""
    result = {}
    for name in JOINTS:
        joints = [next(joint for joint in model.joints if joint.name == name) for model in (found, truth)]
        distances, angles = [], []
        for side, body in (("in_parent", "parent_body"), ("in_child", "child_body")):
            laid = _laid_on(found, truth, getattr(joints[0], body))
            if laid is None:
                continue
            rotation, shift = laid
            poses = [getattr(joint, side) for joint in joints]
            offset = rotation @ poses[0].translation + shift - np.asarray(poses[1].translation)
            if name in HINGES:
                # The axis of rotation in the joint's frame; it is oblique to the frame in the ankle.
                turns = _hinge(joints[1])
                ours, axis = (np.asarray(pose.rotation) @ turns for pose in poses)
                ours = rotation @ ours
                offset = offset - axis * (axis @ offset)
                angles.append(float(np.arccos(np.clip(ours @ axis, -1.0, 1.0))))
            distances.append(float(np.linalg.norm(offset)))
        result[name] = (float(np.mean(distances)), float(np.mean(angles)) if angles else np.nan)
    return result


def _hinge(joint: Joint) -> np.ndarray:
    """Axis of a hinge in the joint's frame."""
    return np.array(
        next(axis.direction for axis in joint.axes or () if axis.kind == "rotation" and axis.coordinate)
    )


def _laid_on(
    found: ModelDescription, truth: ModelDescription, body: str
) -> tuple[np.ndarray, np.ndarray] | None:
    """Find the rigid motion that lays an estimated body's markers on the true ones; None with too few."""
    places = [
        {marker.name: marker.location for marker in model.markers if marker.body == body}
        for model in (found, truth)
    ]
    names = [name for name in places[0] if name in places[1]]
    if len(names) < 3:
        return None
    ours, theirs = (np.array([place[name] for name in names]) for place in places)
    u, _, v = np.linalg.svd((theirs - theirs.mean(axis=0)).T @ (ours - ours.mean(axis=0)))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return rotation, theirs.mean(axis=0) - rotation @ ours.mean(axis=0)


def recover(
    folder: Path,
    data: Path,
    seed: int,
    skin: float,
    curvature: float = 0.0,
    cameras: float = 0.0,
    saturating: bool = False,
) -> tuple[dict[str, tuple[float, float]], JointPersonalisation, Float[np.ndarray, " parameter"]]:
    """Make a person, personalise the starting model, and return errors, result and the true values.

    Parameters
    ----------
    folder, data
        Folder for files, and the recorded person's.
    seed
        Seed of the person.
    skin
        Root mean square movement of skin, m; 0 for none, with priors off.
    curvature
        Size of the movement in proportion to squared angles, against that with angles.
    cameras
        Standard deviation of the white noise of a marker's coordinate, m.
    saturating
        Whether skin follows large angles less than small ones.
    """
    rng = np.random.default_rng(seed)
    model, true_model = data / "model.osim", folder / f"true{seed}.osim"
    parameters = freed()
    sizes = np.array([{"m": CENTRE, "rad": AXIS, "1": SCALE}[entry.unit] for entry in parameters])
    truth = sizes * rng.uniform(-1.0, 1.0, len(parameters))
    write_person(model, true_model, truth, parameters)
    description = describe_model(model)
    coordinates = [entry.name for entry in description.coordinates if not entry.coupled_to]
    names = tuple(marker.name for marker in description.markers if marker.body in BODIES)
    gains = skin_gains(description, names, coordinates, rng)
    made = motions(data, coordinates)
    moved = moved_skin(made, gains, skin, rng, curvature, saturating)
    trials = []
    for name, motion in made.items():
        file = folder / f"{name}{seed}.trc"
        markers = recorded(true_model, coordinates, motion, names, moved[name])
        seen = markers.positions + cameras * rng.normal(size=markers.positions.shape)
        write_trc(file, replace(markers, positions=seen))
        trials.append(MarkerTrial(name, file))
    settings = JointSettings(
        file=folder / "joints.toml",
        name=f"person {seed}",
        model_file=model,
        trials=tuple(trials),
        parameters=tuple(parameters),
        prior_factor=1.0 if skin else 1e3,
        skin_movement=0.005 if skin else 0.0,
    )
    # No frame is held out here: a trial for validation says so.
    done = personalize_joints(
        replace(settings, trials=(*trials, replace(trials[0], use="validation", name="v")))
    )
    return errors(done.after, describe_model(true_model)), done, truth


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--people", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--curvature", type=float, default=0.0, help="movement with squared angles, share")
    parser.add_argument("--cameras-mm", type=float, default=0.0, help="white noise of a coordinate, mm")
    parser.add_argument("--saturating", action="store_true", help="skin follows large angles less")
    options = parser.parse_args()
    set_up_jax()
    data = Path(os.environ["WRAPJAX_DATA"]) / "healthy_running"
    with tempfile.TemporaryDirectory() as folder:
        exact, _, _ = recover(Path(folder), data, options.first, 0.0)
        print("without errors, priors off (centre in mm, axis in degrees):")
        for joint, (distance, angle) in exact.items():
            print(f"  {joint}: {1e3 * distance:.5f} mm, {np.degrees(angle):.5f} deg", flush=True)
        distances, angles, covered, rms = [], [], [], []
        for seed in range(options.first, options.first + options.people):
            found, done, truth = recover(
                Path(folder),
                data,
                seed,
                SKIN,
                options.curvature,
                1e-3 * options.cameras_mm,
                options.saturating,
            )
            distances += [value[0] for value in found.values()]
            angles += [value[1] for value in found.values() if np.isfinite(value[1])]
            covered.append(np.abs(done.values - truth) <= 1.645 * done.posterior.sd)
            rms.append([1e3 * (done.rms[key] or np.nan) for key in ("before", "after")])
            rows = ", ".join(
                f"{joint} {1e3 * distance:.1f} mm"
                + ("" if np.isnan(angle) else f" {np.degrees(angle):.1f} deg")
                for joint, (distance, angle) in found.items()
            )
            print(
                f"person {seed}: {rows}; markers {rms[-1][0]:.1f} -> {rms[-1][1]:.1f} mm; "
                f"in 90 % intervals {100 * covered[-1].mean():.0f} %; {done.seconds:.0f} s",
                flush=True,
            )
    centre, axis = 1e3 * np.array(distances), np.degrees(angles)
    harder = ", saturating" if options.saturating else ""
    harder += f", curvature {options.curvature:g}, cameras {options.cameras_mm:g} mm"
    print(f"{options.people} people, skin {1e3 * SKIN:.1f} mm{harder}:")
    for number, joint in enumerate(JOINTS):
        of_joint = np.median(1e3 * np.array(distances[number :: len(JOINTS)]))
        print(f"  {joint}: center {of_joint:.1f} mm (median)")
    far = [np.percentile(values, 95) for values in (centre, axis)]
    print(f"  centres: median {np.median(centre):.1f} mm (aim 2), 95th percentile {far[0]:.1f} (aim 6)")
    print(f"  axes: median {np.median(axis):.1f} deg (aim 1), 95th percentile {far[1]:.1f} (aim 3)")
    print(f"  values in their 90 % intervals: {100 * np.mean(covered):.0f} % (aim 85 to 95)")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
