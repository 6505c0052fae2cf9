"""Put a loaded OpenSim model into poses and read its muscles' lengths and moment arms.

Two things here are many times faster than the obvious way and give the same numbers:

- coupled coordinates are set from their couplers' functions instead of by ``Model.assemble`` (40 times);
- a muscle's moment arm about a coordinate is minus its lengthening speed while that coordinate moves
  at unit speed and coupled ones follow. One velocity stage serves all muscles and wraps nothing anew
  (50 times). ``computeMomentArm`` agrees to 1e-15 m for paths of fixed points with at most one
  cylinder. With two it does not: OpenSim 4.6 then keeps stale wrap points, and differently in either
  function. Those paths, and any with moving points, go through ``computeMomentArm``, the judge.

Move, turn and scale the wrap cylinders of a loaded model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.osim.loading import import_opensim, load_model
from wrapjax.osim.model import couplers_of, elements, independent_names

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


class PathEngine:
    """One loaded model, ready to be posed again and again.

    Holds OpenSim's own objects: it cannot be pickled, and belongs to one process.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    coordinates
        Independent, unlocked coordinates that poses are given in. The others stay at their defaults.
    spans
        The muscles, and the coordinates that each one's length depends on.
    """

    def __init__(self, model_file: Path | str, coordinates: Sequence[str], spans: dict[str, tuple[str, ...]]):
        opensim = import_opensim()
        self._opensim = opensim
        self._model, self._state = load_model(model_file)
        coordinate_set = self._model.getCoordinateSet()
        self._coordinates = [coordinate_set.get(name) for name in coordinates]
        self._couplers = [
            (
                coordinate_set.get(coupler.getDependentCoordinateName()),
                [coordinate_set.get(name) for name in independent_names(coupler)],
                coupler.getFunction(),
                float(coupler.getPropertyByName("scale_factor").toString()),
            )
            for coupler in couplers_of(opensim, self._model)
        ]
        self._muscles = [self._model.getMuscles().get(name) for name in spans]
        self._cylinders = nominal_cylinders(opensim, self._model)
        # For each coordinate the muscles (by number) that span it: quick ones and those that need the judge.
        quick = [_has_a_plain_path(muscle) for muscle in self._muscles]
        spanning = [[i for i, span in enumerate(spans.values()) if name in span] for name in coordinates]
        self._quick = [[i for i in row if quick[i]] for row in spanning]
        self._judged = [[i for i in row if not quick[i]] for row in spanning]

    def analyse(
        self, poses: Float[np.ndarray, "pose coordinate"]
    ) -> tuple[Float[np.ndarray, "pose muscle"], Float[np.ndarray, "pose coordinate muscle"]]:
        """Return lengths (m) and moment arms (m, zero where not spanned) at the poses (rad or m)."""
        length = np.zeros((len(poses), len(self._muscles)))
        moment_arm = np.zeros((len(poses), len(self._coordinates), len(self._muscles)))
        for pose, length_row, arm_rows in zip(poses, length, moment_arm, strict=True):
            self._set_pose(pose)
            self._model.realizePosition(self._state)
            length_row[:] = [muscle.getLength(self._state) for muscle in self._muscles]
            for index, coordinate in enumerate(self._coordinates):
                for muscle in self._judged[index]:
                    arm_rows[index, muscle] = self._muscles[muscle].computeMomentArm(self._state, coordinate)
                if self._quick[index]:
                    self._move_alone(coordinate)
                    for muscle in self._quick[index]:
                        arm_rows[index, muscle] = -self._muscles[muscle].getLengtheningSpeed(self._state)
        return length, moment_arm

    def analyse_placed(
        self, placements: Sequence[Mapping[str, WrapParameters]], poses: Float[np.ndarray, "pose coordinate"]
    ) -> tuple[
        Float[np.ndarray, "placement pose muscle"], Float[np.ndarray, "placement pose coordinate muscle"]
    ]:
        """Do the same with cylinders moved, once for each placement (see `place`)."""
        found = []
        for wraps in placements:
            self.place(wraps)
            found.append(self.analyse(poses))
        length, moment_arm = zip(*found, strict=True)
        return np.stack(length), np.stack(moment_arm)

    def place(self, wraps: Mapping[str, WrapParameters]) -> None:
        """Move, turn and scale cylinders, each from where the model's file has it.

        Parameters
        ----------
        wraps
            By name, the parameters that `NominalCylinder.place` takes. Others go back to where the file
            has them.
        """
        for name, cylinder in self._cylinders.items():
            cylinder.place(self._opensim, wraps.get(name, NOMINAL))
        self._state = self._model.initSystem()
        for coordinate in elements(self._model.getCoordinateSet()):
            coordinate.setValue(self._state, coordinate.getDefaultValue(), False)

    def touching(self, poses: Float[np.ndarray, "pose coordinate"]) -> set[int]:
        """Find the muscles (by number) that lie on a wrapping surface in at least one of the poses."""
        found: set[int] = set()
        for pose in poses:
            self._set_pose(pose)
            self._model.realizePosition(self._state)
            for number, muscle in enumerate(self._muscles):
                if number not in found and self._touches(muscle):
                    found.add(number)
        return found

    def _touches(self, muscle: Any) -> bool:
        # A path that leaves a surface has no wrap points any more.
        points = muscle.getGeometryPath().getCurrentPath(self._state)
        wrapping = self._opensim.PathWrapPoint.safeDownCast
        return any(wrapping(points.get(place)) is not None for place in range(points.getSize()))

    def _set_pose(self, pose: Float[np.ndarray, " coordinate"]) -> None:
        state = self._state
        for coordinate, value in zip(self._coordinates, pose, strict=True):
            # False: neither clamped to its range nor assembled.
            coordinate.setValue(state, float(value), False)
        for dependent, independent, function, scale in self._couplers:
            inputs = self._vector([coordinate.getValue(state) for coordinate in independent])
            dependent.setValue(state, scale * function.calcValue(inputs), False)

    def _move_alone(self, moving: Any) -> None:
        """Give one coordinate unit speed, those coupled to it the speed that follows, others none."""
        state = self._state
        state.setU(self._vector([0.0] * state.getNU()))
        moving.setSpeedValue(state, 1.0)
        for dependent, independent, function, scale in self._couplers:
            inputs = self._vector([coordinate.getValue(state) for coordinate in independent])
            speed = 0.0
            for number, coordinate in enumerate(independent):
                slope = function.calcDerivative(self._opensim.StdVectorInt([number]), inputs)
                speed += scale * slope * coordinate.getSpeedValue(state)
            dependent.setSpeedValue(state, speed)
        self._model.realizeVelocity(state)

    def _vector(self, values: Sequence[float]) -> Any:
        vector = self._opensim.Vector(len(values), 0.0)
        for index, value in enumerate(values):
            vector.set(index, value)
        return vector


def _has_a_plain_path(muscle: Any) -> bool:
    """Say whether lengthening speed and moment arm are the same thing in OpenSim for this path."""
    path = muscle.getGeometryPath()
    fixed = all(point.getConcreteClassName() == "PathPoint" for point in elements(path.getPathPointSet()))
    return fixed and path.getWrapSet().getSize() <= 1
