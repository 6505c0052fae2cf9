"""A skeleton with markers as a function of freed parameters, in JAX."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.geometry.marker_model import MarkerModel
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.joints.freed_parameters import FRAME_KINDS, FreedParameter


class SkeletonChange(eqx.Module):
    """Maps from freed parameters to changes of a skeleton's frames, scales and markers.

    Parameters
    ----------
    frames
        Maps to the changes of parent and child frames, by `FRAME_KINDS`: ``joint axis parameter``.
    scales
        Map to the changes of scales: ``body axis parameter``.
    places
        Map to the changes of markers: ``marker axis parameter``.
    scaled
        Whether each translation of each joint grows with the parent body: ``joint translation``.
    """

    frames: tuple[Float[np.ndarray, "joint axis parameter"], ...]
    scales: Float[np.ndarray, "body axis parameter"]
    places: Float[np.ndarray, "marker axis parameter"]
    scaled: Float[np.ndarray, "joint translation"]

    def apply(self, model: MarkerModel, values: Float[Array | np.ndarray, " parameter"]) -> MarkerModel:
        """Change a model: scale its bodies as OpenSim does, then move frames and markers.

        Parameters
        ----------
        model
            Starting model.
        values
            Values of the parameters.
        """
        skeleton, parents = model.skeleton, np.array(model.structure.parents)
        parent_move, parent_turn, child_move, child_turn = (frames @ values for frames in self.frames)
        scales = 1.0 + self.scales @ values
        of_parent, of_child = scales[parents], scales[1:]
        axes = jnp.asarray(skeleton.axes[:, model.structure.rotations :])
        along = jnp.sum(jnp.abs(axes) * of_parent[:, None, :], axis=-1)
        changed = skeleton._replace(
            parent_origin=skeleton.parent_origin * of_parent + parent_move,
            child_origin=skeleton.child_origin * of_child + child_move,
            parent_rotation=jnp.asarray(skeleton.parent_rotation) @ rotation_xyz(parent_turn),
            child_rotation=jnp.asarray(skeleton.child_rotation) @ rotation_xyz(child_turn),
            translation_factors=jnp.where(self.scaled > 0.0, along, 1.0),
        )
        locations = model.locations * scales[np.array(model.carriers)] + self.places @ values
        return MarkerModel(model.structure, model.carriers, changed, locations)


def rotation_xyz(angles: Float[Array | np.ndarray, "joint 3"]) -> Float[Array, "joint 3 3"]:
    """Rotation matrices of successive rotations about x, y and z of the turning frame, rad."""
    (sx, sy, sz), (cx, cy, cz) = jnp.sin(angles).T, jnp.cos(angles).T
    rows = [
        [cy * cz, -cy * sz, sy],
        [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
        [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def skeleton_change(
    description: ModelDescription,
    model: MarkerModel,
    markers: Sequence[str],
    parameters: Sequence[FreedParameter],
    combination: Float[np.ndarray, "parameter unknown"] | None = None,
) -> SkeletonChange:
    """Build the maps from freed parameters to a model's skeleton.

    Parameters
    ----------
    description, model
        Model, and its skeleton with markers.
    markers
        Names of the skeleton's markers.
    parameters
        Freed parameters. Those of parts that move no marker change nothing.
    combination
        Map from unknowns to the parameters, if these are not the unknowns themselves; then the maps returned
        are those from unknowns.
    """
    structure, count = model.structure, len(parameters)
    frames = tuple(np.zeros((len(structure.joints), 3, count)) for _ in FRAME_KINDS)
    scales, places = np.zeros((len(structure.bodies), 3, count)), np.zeros((len(markers), 3, count))
    for column, parameter in enumerate(parameters):
        axes = slice(None) if parameter.axis < 0 else parameter.axis
        if parameter.kind in FRAME_KINDS and parameter.owner in structure.joints:
            rows = frames[FRAME_KINDS.index(parameter.kind)]
            rows[structure.joints.index(parameter.owner), axes, column] = 1.0
        elif parameter.kind == "scale" and parameter.owner in structure.bodies:
            scales[structure.bodies.index(parameter.owner), axes, column] = 1.0
        elif parameter.kind == "marker" and parameter.owner in markers:
            places[list(markers).index(parameter.owner), axes, column] = 1.0
    if combination is not None:
        frames = tuple(rows @ combination for rows in frames)
        scales, places = scales @ combination, places @ combination
    return SkeletonChange(frames, scales, places, _scaled_translations(description, model))


def _scaled_translations(
    description: ModelDescription, model: MarkerModel
) -> Float[np.ndarray, "joint translation"]:
    """Find the translations of custom joints that OpenSim scales: all but a coordinate's own value."""
    structure, shape = model.structure, np.shape(model.skeleton.translation_factors)
    by_name = {joint.name: joint for joint in description.joints}
    scaled = np.zeros(shape)
    for row, name in enumerate(structure.joints):
        joint = by_name[name]
        translations = [axis for axis in joint.axes or () if axis.kind == "translation"]
        for slot, axis in enumerate(translations):
            own_value = axis.coordinate is not None and _is_identity(axis.function)
            scaled[row, slot] = joint.kind == "CustomJoint" and not own_value
    return scaled


def _is_identity(function: object) -> bool:
    return getattr(function, "coefficients", None) == (1.0, 0.0)
