"""Simulated persons whose wrapping cylinders differ from those of their model file.

A `Person` of the bank already has small hidden errors: path points differ by a millimeter or two, cylinders
by a millimeter and two percent. Here every cylinder is also moved, turned and resized by some millimeters,
degrees and percent, as a model scaled from markers differs from bones that were not imaged; OpenSim computes
the paths round them. There is no other effect. Tendons are lengthened by the mean change of path length, so
that the fibers work at the same lengths.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from validation.blind.anatomy import COORDINATES, Cylinder, Leg
from validation.blind.dynamometer import ISOMETRIC, PASSIVE, add_trials
from validation.blind.folder import write_folder
from validation.blind.geometry import changed_paths
from validation.blind.noise import moment_noise, noisy_envelopes
from validation.blind.oracle import cycles
from validation.blind.person import Person, draw_person
from validation.blind.world import Paths, World, record, with_muscles
from validation.blind.worlds import default_world

#: Standard deviations of displacements: along each axis (m), about x and y (rad), of the radius (share).
PLACE, TURN, RADIUS = 0.004, float(np.radians(5.0)), 0.06
#: Largest displacement in standard deviations: 8 mm, 10 degrees, 12 percent.
MOST = 2.0
#: Least distance (m) between a cylinder and the path points fixed to its body.
CLEARANCE = 0.001
#: Change of a path length between frames (m) above which the path has flipped to the other side.
FLIP = 0.003
#: Least change (m) of some path length by a displaced cylinder; otherwise no path touches it.
TOUCHED = 1e-4
#: Frames of a cycle, including both ends, at which true moment arms are stored.
FRAMES = 101
#: Differs from the seeds of all banks.
_SEED = 61_417
_DRAWS = 40


@dataclass(frozen=True)
class HiddenWraps:
    """Person with displaced cylinders.

    Parameters
    ----------
    who
        Person before the displacement, with the nominal leg of the model file.
    world
        World after the displacement.
    """

    who: Person
    world: World

    @property
    def wraps(self) -> dict[str, list[float]]:
        """Wrap parameters of the true cylinders relative to the nominal ones, with the small hidden errors.

        Translation along x, y, z of the nominal frame (m), body-fixed rotation about x and y (rad), and ratio
        of the radii.
        """
        pairs = zip(self.world.leg.cylinders, self.who.nominal.cylinders, strict=True)
        return {
            true.name: [
                *(float(a - b) for a, b in zip(true.translation, nominal.translation, strict=True)),
                *true.rotation[:2],
                true.radius / nominal.radius,
            ]
            for true, nominal in pairs
        }


def hidden_wraps(seed: int, family: str = "millard") -> HiddenWraps:
    """Draw a person and displace their cylinders; the same seed gives the same person.

    Parameters
    ----------
    seed
        Number of the person.
    family
        Curves and activation dynamics, a key of `families.FAMILIES`.
    """
    who = draw_person(f"hidden_{seed:03d}", (_SEED, 0, seed), default_world(family))
    return HiddenWraps(who, displace(who.world, np.random.default_rng((_SEED, 1, seed))))


def displace(world: World, rng: np.random.Generator) -> World:
    """Displace all cylinders, each with new draws until its paths change without flipping.

    Raises
    ------
    ValueError
        If no draw of a cylinder satisfies this.
    """
    displaced = world
    for cylinder in world.leg.cylinders:
        displaced = _displace_cylinder(displaced, cylinder, rng)
    # Fibers keep their lengths.
    longer = (displaced.paths.length - world.paths.length).mean(axis=(0, 2))
    return with_muscles(displaced, tendon_slack_length=displaced.muscles.tendon_slack_length + longer)


def _displace_cylinder(world: World, cylinder: Cylinder, rng: np.random.Generator) -> World:
    for _ in range(_DRAWS):
        moved = _moved(cylinder, np.clip(rng.standard_normal(6), -MOST, MOST))
        leg = replace(
            world.leg,
            cylinders=tuple(moved if c.name == cylinder.name else c for c in world.leg.cylinders),
        )
        if clearance(leg, moved) < CLEARANCE:
            continue
        users = [index for index, m in enumerate(leg.muscles) if cylinder.name in m.cylinders]
        paths = changed_paths(world, leg, muscles=users)
        if changes_smoothly(world.paths, paths):
            return replace(world, leg=leg, paths=paths, own_paths=paths)
    raise ValueError(f"no suitable displacement was found for {cylinder.name}")


def _moved(cylinder: Cylinder, draw: np.ndarray) -> Cylinder:
    """Displace a cylinder by six standard normal draws."""
    x, y, z = np.array(cylinder.translation) + PLACE * draw[:3]
    about_x, about_y = TURN * draw[3:5]
    return replace(
        cylinder,
        translation=(float(x), float(y), float(z)),
        rotation=(float(about_x), float(about_y), 0.0),
        radius=float(cylinder.radius * (1.0 + RADIUS * draw[5])),
    )


def axis_of(cylinder: Cylinder) -> np.ndarray:
    """Compute the unit vector of a cylinder's axis in its body."""
    x, y, _ = cylinder.rotation
    return np.array([np.sin(y), -np.sin(x) * np.cos(y), np.cos(x) * np.cos(y)])


def clearance(leg: Leg, cylinder: Cylinder) -> float:
    """Compute the least distance (m) of its muscles' points on its body from a cylinder; inside: negative."""
    points = np.array(
        [
            place
            for muscle in leg.muscles
            if cylinder.name in muscle.cylinders
            for body, place in muscle.points
            if body == cylinder.body
        ]
    )
    off = points - np.array(cylinder.translation)
    axis = axis_of(cylinder)
    away = np.linalg.norm(off - np.outer(off @ axis, axis), axis=1)
    return float(away.min() - cylinder.radius)


def changes_smoothly(before: Paths, after: Paths) -> bool:
    """Check that paths differ, and that the difference changes by less than `FLIP` within 1/50 s."""
    change = after.length - before.length
    steps = np.abs(np.diff(change[..., ::10], axis=-1))
    return bool(np.abs(change).max() > TOUCHED and steps.max() < FLIP)


def at_frames(world: World, values: np.ndarray) -> np.ndarray:
    """Sample (recording, ..., frame) over all cycles in the order of the folder: (cycle, ..., 101)."""
    time, out = world.walk.time, []
    for recording, pairs in enumerate(cycles(world)):
        for start, end in pairs:
            place = np.interp(np.linspace(start, end, FRAMES), time, np.arange(time.size))
            low = np.minimum(place.astype(int), time.size - 2)
            share = place - low
            recorded = values[recording]
            out.append((1.0 - share) * recorded[..., low] + share * recorded[..., low + 1])
    return np.stack(out)


def write_hidden(
    hidden: HiddenWraps, seed: int, emg_noise: float, folder: Path, *, tasks: bool = False
) -> None:
    """Write the subject folder ``subject/`` and the true values in one atomic step.

    Moments have the noise of the bank. ``truth.npz`` has moment arms (cycle, muscle, coordinate, frame) in m:
    ``arms`` are the true ones and ``undisplaced`` those before the displacement; ``muscles`` and
    ``coordinates`` name the axes. ``truth.json`` has the wrap parameters of the true cylinders.

    Parameters
    ----------
    hidden
        Person with displaced cylinders.
    seed
        Number of the person, for the noise.
    emg_noise
        Noise as a share of the envelopes.
    folder
        Folder to write.
    tasks
        Whether the person also does passive rotations and isometric ramps; the walk stays the same.
    """
    who, world = hidden.who, hidden.world
    rng = np.random.default_rng((_SEED, 2, seed))
    clean = record(world)
    recorded = {
        "moments": clean.moments + moment_noise(world.walk, world.leg.mass, rng),
        "emg": noisy_envelopes(clean.emg, emg_noise, rng),
        "pose": clean.pose,
        "ground": clean.ground,
    }
    work = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(work, ignore_errors=True)
    write_folder(work / "subject", who.nominal, who.paretic, world.walk.speeds, cycles(world), recorded)
    if tasks:
        own = np.random.default_rng((_SEED, 3, seed))
        add_trials(work / "subject", world, (*PASSIVE, *ISOMETRIC), emg_noise, own)
    np.savez(
        work / "truth.npz",
        arms=at_frames(world, world.paths.arms),
        undisplaced=at_frames(world, who.world.paths.arms),
        muscles=np.array(world.leg.names),
        coordinates=np.array(COORDINATES),
    )
    (work / "truth.json").write_text(json.dumps({"wraps": hidden.wraps}, indent=1) + "\n", encoding="utf-8")
    work.rename(folder)
