"""The virtual person's hidden cylinders: where theirs are, and the model's are not."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.geometry.engine import GEODESIC, PARITY, ExactPaths, PosedPath, wrap_at_samples
from wrapjax.geometry.surfaces import NOMINAL, WRAP_PARAMETERS
from wrapjax.geometry.walls import walls_before
from wrapjax.geometry.wrap_boxes import usable_samples
from wrapjax.osim import describe_model
from wrapjax.virtual.anatomy import COORDINATES, CYLINDERS
from wrapjax.virtual.mirror import on_side
from wrapjax.virtual.muscles import MUSCLES

#: How far a cylinder may be from the model's, along every parameter, where the spread is one. Chosen here:
#: within the narrowest box that a calibration searches.
LARGEST_CHANGE = np.array([5e-3, 5e-3, 5e-3, np.radians(10.0), np.radians(10.0), 0.1])
#: Draws of a cylinder before it is given up. Most first ones will do.
_DRAWS = 24
# How much further OpenSim's path may be from the shortest one (m) than with the nominal cylinder: more is one
# of its defects.
_DEFECT = 5e-4


def draw_wraps(
    generator: np.random.Generator,
    model_file: Path,
    angles: Float[np.ndarray, "cycle frame coordinate"],
    spread: float,
    side: str = "r",
) -> dict[str, Float[np.ndarray, " wrap_parameter"]]:
    """Draw where a person's cylinders are.

    Parameters
    ----------
    generator
        As much is drawn from it whatever comes of it.
    model_file
        The virtual leg, with nominal cylinders.
    angles
        Of the cycles walked, rad, columns as `COORDINATES`.
    spread
        Largest change of every parameter, in `LARGEST_CHANGE`; draws are uniform.
    side
        Which leg it is.

    Returns
    -------
    dict of Array
        By cylinder, its parameters as in `WRAP_PARAMETERS`: the first draw with which all its muscles'
        paths run as they do round the nominal one, without a jump and touching it, and as far from
        jumping as a calibration keeps them.

    Raises
    ------
    ValueError
        If none of a cylinder's draws will do: the spread is too large.
    """
    model = describe_model(model_file)
    coordinates = tuple(on_side(name, side) for name in COORDINATES)
    draws = generator.uniform(-1.0, 1.0, (len(CYLINDERS), _DRAWS, len(WRAP_PARAMETERS)))
    users = {
        cylinder.name: [muscle.name for muscle in MUSCLES if muscle.cylinder == cylinder.name]
        for cylinder in CYLINDERS
    }
    # All muscles at once: then one program serves all their paths.
    wrapped = [on_side(muscle, side) for muscles in users.values() for muscle in muscles]
    frames = angles.shape[1]
    posed = ExactPaths(model, wrapped, coordinates).posed(angles.reshape(-1, len(coordinates)))
    wraps = {}
    for cylinder, own in zip(CYLINDERS, NOMINAL + spread * LARGEST_CHANGE * draws, strict=True):
        name = on_side(cylinder.name, side)
        paths = [posed[on_side(muscle, side)] for muscle in users[cylinder.name]]
        usable = np.all([_runs_alike(path, own, frames) for path in paths], axis=0)
        if not usable.any():
            raise ValueError(
                f"no place was found for cylinder '{name}': a wrap spread of {spread} is too much"
            )
        wraps[name] = own[usable.argmax()]
    return wraps


def _runs_alike(
    path: PosedPath, samples: Float[np.ndarray, "sample wrap_parameter"], frames: int
) -> Bool[np.ndarray, " sample"]:
    """Tell placements where the shortest path is usable, and OpenSim's, which the person has, follows it.

    Usable, too, for a calibration: one beyond its walls could be found by none.
    """
    moved = np.concatenate([NOMINAL[None], samples])[:, None]
    shortest, others = (wrap_at_samples(path, moved, way) for way in (GEODESIC, PARITY))
    apart = np.abs(others.length - shortest.length).max(axis=1)
    walls = walls_before(jax.tree.map(lambda leaf: leaf[:1], shortest), frames)
    walls = jax.tree.map(lambda leaf: leaf[0], walls)
    closeness = jax.vmap(walls.closeness)(shortest.clearances[1:], shortest.on_surface[1:])
    within = np.isfinite(np.asarray(closeness)).all(axis=1)
    return usable_samples(path, 0, samples) & within & (apart[1:] <= apart[0] + _DEFECT)
