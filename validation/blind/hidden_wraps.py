"""People whose cylinders are elsewhere than in the model file that a laboratory has of them.

A `Person` of the bank already has what nobody measures: path points off by a millimetre or two, cylinders by
a millimetre and two percent. Here every cylinder is moved, turned and resized on top of that, by some
millimetres, degrees and percent, as a model scaled from markers is off from bones that nobody imaged; OpenSim
wraps round them. Nothing else is amiss. Tendons are as much longer as the paths are on average, so that
fibers work where they did.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from validation.blind.anatomy import COORDINATES, Cylinder, Leg
from validation.blind.folder import write_folder
from validation.blind.geometry import changed_paths
from validation.blind.noise import moment_noise, noisy_envelopes
from validation.blind.oracle import cycles
from validation.blind.person import Person, person
from validation.blind.world import Paths, World, record, with_muscles

#: Standard deviations of what is hidden: along each axis (m), about x and y (rad), of the radius (share).
PLACE, TURN, RADIUS = 0.004, float(np.radians(5.0)), 0.06
#: No draw is further out, in standard deviations: 8 mm, 10 degrees, 12 percent.
MOST = 2.0
#: Bone swallows no point of a path that is fixed to it: this much (m) stays between point and cylinder.
CLEARANCE = 0.001
#: A path that leaps from frame to frame by more than this (m) has flipped round its cylinder.
LEAP = 0.003
#: A cylinder that changes no path by this much (m) is not touched: it would hide nothing.
TOUCHED = 1e-4
#: Frames of a cycle, its two ends among them, at which the truth is kept.
FRAMES = 101
#: Apart from all banks.
_SEED = 61_417
_DRAWS = 40


@dataclass(frozen=True)
class HiddenWraps:
    """A person whose cylinders were displaced.

    Parameters
    ----------
    who
        Before that; what the laboratory believes of them.
    world
        After it.
    """

    who: Person
    world: World

    @property
    def wraps(self) -> dict[str, list[float]]:
        """How far each true cylinder is from the believed one, the person's usual small errors included.

        Along x, y, z of the believed one (m), turned about its x and y (rad, body-fixed), radius as a
        multiple of the believed one.
        """
        pairs = zip(self.world.leg.cylinders, self.who.nominal.cylinders, strict=True)
        return {
            true.name: [
                *(float(a - b) for a, b in zip(true.translation, believed.translation, strict=True)),
                *true.rotation[:2],
                true.radius / believed.radius,
            ]
            for true, believed in pairs
        }


def hidden_wraps(seed: int, family: str = "millard") -> HiddenWraps:
    """Draw a person and displace their cylinders; the same seed gives the same person.

    Parameters
    ----------
    family
        Curves and activation, from `families.FAMILIES`.
    """
    who = person(f"hidden_{seed:03d}", (_SEED, 0, seed), family)
    return HiddenWraps(who, displace(who.world, np.random.default_rng((_SEED, 1, seed))))


def displace(world: World, rng: np.random.Generator) -> World:
    """Displace all cylinders, each until its muscles run round it without a leap.

    Raises
    ------
    ValueError
        If none of a cylinder's draws will do.
    """
    now = world
    for cylinder in world.leg.cylinders:
        now = _displaced(now, cylinder, rng)
    # Fibers where they were.
    longer = (now.paths.length - world.paths.length).mean(axis=(0, 2))
    return with_muscles(now, tendon_slack_length=now.muscles.tendon_slack_length + longer)


def _displaced(world: World, cylinder: Cylinder, rng: np.random.Generator) -> World:
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
        if runs_on(world.paths, paths):
            return replace(world, leg=leg, paths=paths, own_paths=paths)
    raise ValueError(f"no place was found for {cylinder.name}")


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
    """Direction of a cylinder's axis in its body, of length one."""
    x, y, _ = cylinder.rotation
    return np.array([np.sin(y), -np.sin(x) * np.cos(y), np.cos(x) * np.cos(y)])


def clearance(leg: Leg, cylinder: Cylinder) -> float:
    """Least distance (m) from a cylinder's surface to its muscles' points on its body; inside: negative."""
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


def runs_on(before: Paths, after: Paths) -> bool:
    """Tell paths that differ, and do so without a leap (`LEAP` a fiftieth of a second)."""
    change = after.length - before.length
    steps = np.abs(np.diff(change[..., ::10], axis=-1))
    return bool(np.abs(change).max() > TOUCHED and steps.max() < LEAP)


def at_frames(world: World, values: np.ndarray) -> np.ndarray:
    """Sample (recording, ..., frame) over all cycles, in the order of the folder's: (cycle, ..., 101)."""
    time, out = world.walk.time, []
    for recording, pairs in enumerate(cycles(world)):
        for start, end in pairs:
            place = np.interp(np.linspace(start, end, FRAMES), time, np.arange(time.size))
            low = np.minimum(place.astype(int), time.size - 2)
            share = place - low
            own = values[recording]
            out.append((1.0 - share) * own[..., low] + share * own[..., low + 1])
    return np.stack(out)


def write_hidden(hidden: HiddenWraps, seed: int, emg_noise: float, folder: Path) -> None:
    """Write ``subject/``, what the laboratory has, and the truth beside it; whole or not at all.

    Moments have the bank's noise. ``truth.npz`` has moment arms (cycle, muscle, coordinate, frame) in m:
    ``arms``, the true ones, and ``undisplaced``, those of the same person before cylinders were displaced;
    ``muscles`` and ``coordinates`` name their axes. ``truth.json`` has the cylinders.

    Parameters
    ----------
    emg_noise
        Share of the envelopes.
    """
    who, world = hidden.who, hidden.world
    rng = np.random.default_rng((_SEED, 2, seed))
    seen = record(world)
    recorded = {
        "moments": seen.moments + moment_noise(world.walk, world.leg.mass, rng),
        "emg": noisy_envelopes(seen.emg, emg_noise, rng),
        "pose": seen.pose,
        "ground": seen.ground,
    }
    work = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(work, ignore_errors=True)
    write_folder(work / "subject", who.nominal, who.paretic, world.walk.speeds, cycles(world), recorded)
    np.savez(
        work / "truth.npz",
        arms=at_frames(world, world.paths.arms),
        undisplaced=at_frames(world, who.world.paths.arms),
        muscles=np.array(world.leg.names),
        coordinates=np.array(COORDINATES),
    )
    (work / "truth.json").write_text(json.dumps({"wraps": hidden.wraps}, indent=1) + "\n", encoding="utf-8")
    work.rename(folder)
