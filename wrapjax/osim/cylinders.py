"""Move, turn and scale the wrap cylinders of a loaded model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

#: Six of a cylinder, as `NominalCylinder.place` takes them.
WrapParameters = Sequence[float] | Float[np.ndarray, " wrap_parameter"]

#: Wrap parameters that leave a cylinder where its model has it.
NOMINAL = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class NominalCylinder:
    """One of OpenSim's cylinders, and where the model's file has it.

    Parameters
    ----------
    cylinder
        ``opensim.WrapCylinder``; lives as long as its model.
    pose
        ``opensim.Transform`` in the frame that carries it, be that a body or an offset frame.
    radius
        m.
    """

    cylinder: Any
    pose: Any
    radius: float

    def place(self, opensim: Any, parameters: WrapParameters) -> None:
        """Move, turn and scale it from where the file has it, not from where it is now.

        Parameters
        ----------
        parameters
            Translation (m) along the nominal frame's axes, turns (rad) about its x and then its own y
            axis, and the factor of the radius.
        """
        x, y, z, turn_x, turn_y, factor = map(float, parameters)
        turn = opensim.Rotation(
            opensim.BodyRotationSequence,
            turn_x,
            opensim.CoordinateAxis(0),
            turn_y,
            opensim.CoordinateAxis(1),
        )
        moved = self.pose.compose(opensim.Transform(turn, opensim.Vec3(x, y, z)))
        self.cylinder.set_translation(moved.p())
        self.cylinder.set_xyz_body_rotation(moved.R().convertRotationToBodyFixedXYZ())
        self.cylinder.set_radius(self.radius * factor)


def nominal_cylinders(opensim: Any, model: Any) -> dict[str, NominalCylinder]:
    """Find the cylinders of a model as it was loaded, by name."""
    found = {}
    for component in model.getComponentsList():
        cylinder = opensim.WrapCylinder.safeDownCast(component)
        if cylinder is not None:
            nominal = cylinder.getTransform()
            # A copy: the cylinder's own transform follows it.
            pose = opensim.Transform(nominal.R(), nominal.p())
            found[cylinder.getName()] = NominalCylinder(cylinder, pose, cylinder.get_radius())
    return found
