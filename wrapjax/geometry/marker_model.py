"""Positions of a skeleton's markers, and their velocities per unit speed of each coordinate, in JAX."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.geometry.skeleton.bodies import Skeleton, SkeletonStructure, body_poses, build_skeleton, stations
from wrapjax.geometry.skeleton.model_description import ModelDescription


class MarkerModel(eqx.Module):
    """Skeleton with markers.

    Parameters
    ----------
    structure, skeleton
        Names and indices, and numbers, of the skeleton.
    carriers
        Index of the body of each marker.
    locations
        Locations of the markers in their bodies' frames, m.
    """

    structure: SkeletonStructure = eqx.field(static=True)
    carriers: tuple[int, ...] = eqx.field(static=True)
    skeleton: Skeleton
    locations: Float[Array | np.ndarray, "marker 3"]

    def positions(self, given: Float[Array, " coordinate"]) -> Float[Array, "marker 3"]:
        """Compute the markers' positions in ground, m, from the given coordinates, rad or m."""
        poses = body_poses(self.structure, self.skeleton, given)
        return stations(poses, np.array(self.carriers), jnp.asarray(self.locations))

    def motion(
        self, given: Float[Array, " coordinate"]
    ) -> tuple[Float[Array, "marker 3"], Float[Array, "marker mover 3"], Float[Array, "mover 3"]]:
        """Compute positions (m), velocities per unit speed of each mover, and angular velocities of movers.

        A mover is a coordinate in one of the joints that it moves (`SkeletonStructure.movers`).
        """
        poses = body_poses(self.structure, self.skeleton, given)
        positions = stations(poses, np.array(self.carriers), jnp.asarray(self.locations))
        rates = jnp.cross(poses.angular[None], positions[:, None, :]) + poses.linear[None]
        return positions, rates * self.moved[..., None], poses.angular

    @property
    def moved(self) -> np.ndarray:
        """Whether each mover moves each marker, ``marker mover``, as numbers."""
        joints = np.array([joint for joint, _ in self.structure.movers], dtype=int)
        return self.structure.ancestors[np.array(self.carriers, dtype=int)][:, joints] * 1.0

    @property
    def carried(self) -> np.ndarray:
        """Whether the first mover rotates the axis of the second one, ``mover mover``, as numbers.

        It does so if its joint is nearer to ground, or is the same and its rotation comes first.
        """
        structure = self.structure
        slots = structure.mover_slots[:, : structure.rotations]
        order = [int(np.argmax(row)) if row.any() else -1 for row in slots]
        count = len(structure.movers)
        carried = np.zeros((count, count))
        for first, (upper, _) in enumerate(structure.movers):
            for second, (lower, _) in enumerate(structure.movers):
                above = structure.ancestors[lower + 1, upper] and upper != lower
                before = upper == lower and 0 <= order[first] <= order[second]
                carried[first, second] = above or before
        return carried

    def by_coordinate(self, values: Float[Array, "mover ..."]) -> Float[Array, "coordinate ..."]:
        """Sum the values of each coordinate's movers."""
        columns = [column for _, column in self.structure.movers]
        count = len(self.structure.coordinates)
        if sorted(columns) == list(range(count)):
            return values[np.argsort(columns)]
        chosen = np.array(columns, dtype=int) == np.arange(count)[:, None]
        return jnp.tensordot(jnp.asarray(chosen * 1.0), values, axes=1)


def build_marker_model(
    model: ModelDescription, coordinates: Sequence[str], markers: Sequence[str]
) -> MarkerModel:
    """Build the skeleton that carries some markers of a model, without bodies that move none of them.

    Parameters
    ----------
    model
        Description of the model.
    coordinates
        Names of the coordinates that will be given.
    markers
        Names of the markers.
    """
    by_name = {marker.name: marker for marker in model.markers}
    chosen = [by_name[name] for name in markers]
    structure, skeleton = build_skeleton(model, coordinates, {marker.body for marker in chosen} - {"ground"})
    return MarkerModel(
        structure=structure,
        carriers=tuple(structure.bodies.index(marker.body) for marker in chosen),
        skeleton=skeleton,
        locations=np.array([marker.location for marker in chosen]),
    )
