"""Wrap surfaces and the six parameters that move, turn and scale them."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.geometry.cylinder import Cylinder
from wrapjax.geometry.vectors import vector

#: A surface's parameters, in their order: translation along the nominal frame's axes, turns about its
#: x and then its own y axis, and the radius as a multiple of the nominal one.
WRAP_PARAMETERS = (
    "translation_x_m",
    "translation_y_m",
    "translation_z_m",
    "rotation_x_rad",
    "rotation_y_rad",
    "radius_factor",
)

#: Leaves a surface as the model has it.
NOMINAL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class Surface(eqx.Module):
    """A cylinder as the model has it, in the frame of the body that carries it."""

    #: Columns are the cylinder's axes.
    rotation: Float[Array, "*surface 3 3"]
    #: m
    center: Float[Array, "*surface 3"]
    radius: Float[Array, "*surface"]
    length: Float[Array, "*surface"]
    side_axis: Array
    side: Array

    def placed(self, parameters: Float[Array, " wrap_parameter"]) -> Cylinder:
        """Move, turn and scale the cylinder: ``R_nominal Rx Ry``, the paper's six wrap parameters."""
        x_axis, y_axis, z_axis = (vector(self.rotation[:, column]) for column in range(3))
        shift = x_axis * parameters[0] + y_axis * parameters[1] + z_axis * parameters[2]
        sine_x, cosine_x = jnp.sin(parameters[3]), jnp.cos(parameters[3])
        sine_y, cosine_y = jnp.sin(parameters[4]), jnp.cos(parameters[4])
        turned_y = y_axis * cosine_x + z_axis * sine_x
        turned_z = z_axis * cosine_x - y_axis * sine_x
        return Cylinder(
            x_axis=x_axis * cosine_y - turned_z * sine_y,
            y_axis=turned_y,
            z_axis=turned_z * cosine_y + x_axis * sine_y,
            center=vector(self.center) + shift,
            radius=self.radius * parameters[5],
            half_length=0.5 * self.length,
            side_axis=self.side_axis,
            side=self.side,
        )
