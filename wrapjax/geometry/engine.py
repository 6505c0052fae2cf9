"""The exact path engine: lengths and moment arms of wrapping paths, without OpenSim.

Two ways of wrapping. `GEODESIC` lays paths the shortest way, so that moment arms are exactly -dL/dq;
whatever moves cylinders uses it, directly or through surrogates. `PARITY` does what OpenSim 4.6 does, to
round-off and with its defects: it says what a model will do in OpenSim, and is what the engine is tested
by. Both can be differentiated by poses and cylinders in forward mode, and in reverse mode too, but for
`PARITY` round several cylinders: OpenSim goes round them as often as it takes, and a loop of unknown
length cannot be gone back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.cylinder import Cylinder, geodesic_contact, spiral_contact
from wrapjax.geometry.kinematics import CoordinateValues, body_motion, path_points
from wrapjax.geometry.model_description import ModelDescription, Muscle
from wrapjax.geometry.path_on_cylinders import PointsAndCarriers
from wrapjax.geometry.placement import points_and_carriers, straight_path, surfaces_of
from wrapjax.geometry.shortest_path import wrap_in_parity, wrap_shortest
from wrapjax.geometry.wrapping import (
    NOMINAL,
    FindContact,
    StraightPath,
    Surface,
    WrappedPath,
    unwrapped,
    wrap_once,
)

#: Evaluations (samples times poses) that are run at once: more of them only fill memory.
_AT_ONCE = 20_000


class Wrapping(NamedTuple):
    """A way of wrapping: round one cylinder, and round several."""

    name: str
    find_contact: FindContact
    wrap_several: Callable[[PointsAndCarriers, Cylinder], WrappedPath]


GEODESIC = Wrapping("geodesic", geodesic_contact, wrap_shortest)
PARITY = Wrapping("parity", spiral_contact, wrap_in_parity)


class PosedPath(eqx.Module):
    """One muscle's path in many poses, ready to be wrapped round cylinders placed at will.

    Leaves of ``path`` lead with ``pose``, those of ``surfaces`` with ``wrap``.
    """

    path: StraightPath | PointsAndCarriers
    surfaces: Surface

    def wrapped(
        self, parameters: Float[Array, "wrap wrap_parameter"], wrapping: Wrapping = GEODESIC
    ) -> WrappedPath:
        """Wrap the path in every pose; leaves of the result lead with ``pose``.

        Parameters
        ----------
        parameters
            Of the muscle's cylinders, as in `WRAP_PARAMETERS`.
        wrapping
            `GEODESIC` or `PARITY`.
        """
        if isinstance(self.path, PointsAndCarriers):
            cylinders = jax.vmap(Surface.placed)(self.surfaces, parameters)
            return jax.vmap(wrapping.wrap_several, in_axes=(0, None))(self.path, cylinders)
        if not parameters.shape[0]:
            return unwrapped(self.path)
        surface = jax.tree.map(lambda leaf: leaf[0], self.surfaces)
        cylinder = surface.placed(parameters[0])
        return jax.vmap(wrap_once, in_axes=(0, None, None))(self.path, cylinder, wrapping.find_contact)


class ExactPaths:
    """The paths of a model's muscles.

    Parameters
    ----------
    model
        From `wrapjax.osim.describe_model`.
    muscles
        Whose paths.
    coordinates
        What poses are given in, and moment arms are about. The model's other coordinates follow their
        couplers or stay at their defaults.

    Raises
    ------
    InputError
        Naming every part of these paths that the engine does not know: wrap objects other than
        cylinders, cylinders restricted along their axis, paths that are not made of points.
    """

    def __init__(self, model: ModelDescription, muscles: Sequence[str], coordinates: Sequence[str]):
        self.model = model
        self.muscles = tuple(muscles)
        self.coordinates = tuple(coordinates)
        problems = [problem for name in muscles for problem in _unknown_parts(model, model.muscle(name))]
        if problems:
            raise InputError(list(dict.fromkeys(problems)))

    def wraps_of(self, muscle: str) -> tuple[str, ...]:
        """Name the cylinders that a muscle may wrap round, in the order of its path."""
        return tuple(
            entry.wrap for entry in self.model.muscle(muscle).wraps if self.model.wrap(entry.wrap).active
        )

    def posed(self, poses: Float[np.ndarray, "pose coordinate"]) -> dict[str, PosedPath]:
        """Put the model into poses (rad or m); give each muscle's path."""
        values = CoordinateValues(self.model, self.coordinates, poses)
        muscles = {name: self.model.muscle(name) for name in self.muscles}
        bodies = {point.body for muscle in muscles.values() for point in muscle.points}
        bodies |= {self.model.wrap(wrap).body for name in muscles for wrap in self.wraps_of(name)}
        motion = body_motion(values, bodies)
        posed = {}
        for name, muscle in muscles.items():
            points = path_points(muscle.points, motion, values)
            wraps = [self.model.wrap(wrap) for wrap in self.wraps_of(name)]
            entries = [entry for entry in muscle.wraps if entry.wrap in self.wraps_of(name)]
            carriers = [(wrap.body, motion[wrap.body]) for wrap in wraps]
            path: StraightPath | PointsAndCarriers
            if len(wraps) > 1:
                path = points_and_carriers(muscle, points, carriers, entries)
            elif wraps:
                path = straight_path(muscle, points, carriers[0][1], entries[0])
            else:
                path = straight_path(muscle, points, motion["ground"], None)
            posed[name] = PosedPath(path, surfaces_of(wraps))
        return _filled_up(posed)


def _filled_up(posed: dict[str, PosedPath]) -> dict[str, PosedPath]:
    """Give all paths by one cylinder as many pieces: then one program serves all of them."""
    single = {
        name: one.path
        for name, one in posed.items()
        if isinstance(one.path, StraightPath) and one.surfaces.radius.size
    }
    most = max((path.eligible.shape[1] for path in single.values()), default=0)
    return posed | {name: PosedPath(path.filled(most), posed[name].surfaces) for name, path in single.items()}


def wrap_at_samples(
    posed: PosedPath,
    parameters: Float[np.ndarray, "sample wrap wrap_parameter"],
    wrapping: Wrapping = GEODESIC,
) -> WrappedPath:
    """Wrap one path round its cylinders at every sample of their parameters, in every pose.

    Returns
    -------
    WrappedPath
        NumPy arrays that lead with ``sample pose``.
    """
    poses = jax.tree.leaves(posed.path)[0].shape[0]
    chunk = max(1, min(len(parameters), _AT_ONCE // poses))
    parts = []
    for first in range(0, len(parameters), chunk):
        part = parameters[first : first + chunk]
        # The last chunk is filled up: another length would be another program to compile.
        filled = np.concatenate([part, np.repeat(part[-1:], chunk - len(part), axis=0)])
        parts.append(jax.tree.map(np.asarray, _at_samples(posed, jnp.asarray(filled), wrapping)))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(parameters)], *parts)


@eqx.filter_jit
def _at_samples(
    posed: PosedPath, parameters: Float[Array, "sample wrap wrap_parameter"], wrapping: Wrapping
) -> WrappedPath:
    return jax.vmap(lambda one: posed.wrapped(one, wrapping))(parameters)


def nominal_parameters(wraps: int) -> Float[np.ndarray, "wrap wrap_parameter"]:
    """Leave cylinders as the model has them."""
    return np.tile(NOMINAL, (wraps, 1))


def _unknown_parts(model: ModelDescription, muscle: Muscle) -> list[Problem]:
    if muscle.path_kind != "GeometryPath":
        return [_refusal(model, f"muscle '{muscle.name}' has a {muscle.path_kind}, no path of points")]
    problems = []
    for entry in muscle.wraps:
        wrap = model.wrap(entry.wrap)
        if not wrap.active:
            continue
        if wrap.kind != "WrapCylinder":
            problems.append(_refusal(model, f"wrap object '{wrap.name}' is a {wrap.kind}, no cylinder"))
        elif wrap.quadrant.endswith("z"):
            problems.append(_refusal(model, f"cylinder '{wrap.name}' is restricted along its own axis"))
    return problems


def _refusal(model: ModelDescription, what: str) -> Problem:
    return Problem(
        model.name,
        f"{what}: the exact engine cannot wrap it",
        hint="NGA, SGA and LSGA go along OpenSim's own paths: 'calibrate' without --fit and --geometry",
    )
