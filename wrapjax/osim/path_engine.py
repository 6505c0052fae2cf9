"""Muscle lengths and moment arms of a loaded OpenSim model, with wraps as in its file or changed.

Two shortcuts give the same numbers as the usual calls of OpenSim in much less time:

- Coupled coordinates are set from their couplers' functions instead of by ``Model.assemble`` (40 times
faster). - A muscle's moment arm about a coordinate is minus its lengthening speed while that coordinate moves
at unit speed
  and coupled ones follow. One velocity stage serves all muscles, and paths are not wrapped again (50 times
  faster). ``computeMomentArm`` agrees to 1e-15 m for paths of fixed points with at most one cylinder. With
  two cylinders it does not, because OpenSim 4.6 keeps stale wrap points, differently in the two functions.
  For those paths, and for any with moving points, ``computeMomentArm`` is used.
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

#: Six or nine wrap parameters of a surface, in the order of `NominalSurface.place`.
WrapParameters = Sequence[float] | Float[np.ndarray, " wrap_parameter"]

#: Wrap parameters of a surface as the model has it.
NOMINAL = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
# Wrap parameters of surfaces other than cylinders beyond these six.
_FURTHER = (0.0, 1.0, 1.0)

# Properties that hold the sizes of each class of wrap object.
_SIZES = {
    "WrapCylinder": ("radius",),
    "WrapSphere": ("radius",),
    "WrapEllipsoid": ("dimensions",),
    "WrapTorus": ("outer_radius", "inner_radius"),
}


@dataclass(frozen=True)
class NominalSurface:
    """Wrap object of a loaded OpenSim model with its nominal pose and sizes.

    Parameters
    ----------
    surface
        ``opensim.WrapObject`` of its own class, valid as long as its model exists.
    pose
        Nominal ``opensim.Transform`` in the frame that carries the surface, a body or an offset frame.
    sizes
        Nominal sizes, m: radius of a cylinder or sphere, semi-axes of an ellipsoid, radii of a torus' ring
        and tube.
    """

    surface: Any
    pose: Any
    sizes: tuple[float, ...]

    @property
    def size_properties(self) -> tuple[str, ...]:
        """Names of the properties that hold the sizes."""
        return _SIZES[self.surface.getConcreteClassName()]

    def place(self, opensim: Any, parameters: WrapParameters) -> None:
        """Set pose and sizes by wrap parameters, relative to the nominal pose and sizes.

        Parameters
        ----------
        opensim
            The imported package.
        parameters
            Translation (m) along the nominal frame's axes, rotation (rad) about its x axis and then about the
            rotated y axis, and a factor of all sizes; optionally rotation (rad) about the z axis after these,
            and further factors of the second and third size.
        """
        x, y, z, turn_x, turn_y, factor = map(float, parameters[:6])
        turn_z, *factors = map(float, parameters[6:]) if len(parameters) > len(NOMINAL) else _FURTHER
        turns = [(turn, opensim.CoordinateAxis(axis)) for axis, turn in enumerate((turn_x, turn_y, turn_z))]
        if turn_z == 0.0:
            turns.pop()
        rotation = opensim.Rotation(opensim.BodyRotationSequence, *(part for turn in turns for part in turn))
        moved = self.pose.compose(opensim.Transform(rotation, opensim.Vec3(x, y, z)))
        self.surface.set_translation(moved.p())
        self.surface.set_xyz_body_rotation(moved.R().convertRotationToBodyFixedXYZ())
        scaled = [size * factor * own for size, own in zip(self.sizes, (1.0, *factors), strict=False)]
        if self.size_properties == ("dimensions",):
            self.surface.set_dimensions(opensim.Vec3(*scaled))
            return
        for name, size in zip(self.size_properties, scaled, strict=True):
            getattr(self.surface, f"set_{name}")(size)


def nominal_surfaces(opensim: Any, model: Any) -> dict[str, NominalSurface]:
    """Find the wrap objects of a newly loaded model, by name."""
    surfaces = {}
    for component in model.getComponentsList():
        wrap = opensim.WrapObject.safeDownCast(component)
        if wrap is None or wrap.getConcreteClassName() not in _SIZES:
            continue
        kind = wrap.getConcreteClassName()
        surface = getattr(opensim, kind).safeDownCast(wrap)
        nominal = surface.getTransform()
        # Copied, because the surface's own transform changes with the surface.
        pose = opensim.Transform(nominal.R(), nominal.p())
        values = [getattr(surface, f"get_{name}")() for name in _SIZES[kind]]
        if kind == "WrapEllipsoid":
            values = [values[0].get(axis) for axis in range(3)]
        surfaces[surface.getName()] = NominalSurface(surface, pose, tuple(map(float, values)))
    return surfaces


class PathEngine:
    """Loaded OpenSim model whose muscle paths are computed in poses.

    It holds OpenSim objects, and can therefore be neither pickled nor shared by processes.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    coordinates
        Names of the independent, unlocked coordinates of poses. Others stay at their defaults.
    spans
        Names of the coordinates that each muscle's length depends on, by muscle name.
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
        self._surfaces = nominal_surfaces(opensim, self._model)
        # For each coordinate the numbers of the muscles that span it, by the method for their moment arms.
        by_speed = [_has_simple_path(muscle) for muscle in self._muscles]
        spanning = [[i for i, span in enumerate(spans.values()) if name in span] for name in coordinates]
        self._by_speed = [[i for i in row if by_speed[i]] for row in spanning]
        self._by_opensim = [[i for i in row if not by_speed[i]] for row in spanning]

    def analyse(
        self, poses: Float[np.ndarray, "pose coordinate"]
    ) -> tuple[Float[np.ndarray, "pose muscle"], Float[np.ndarray, "pose coordinate muscle"]]:
        """Compute lengths (m) and moment arms (m, zero where not spanned) at poses (rad or m)."""
        length = np.zeros((len(poses), len(self._muscles)))
        moment_arm = np.zeros((len(poses), len(self._coordinates), len(self._muscles)))
        for pose, length_row, arm_rows in zip(poses, length, moment_arm, strict=True):
            self._set_pose(pose)
            self._model.realizePosition(self._state)
            length_row[:] = [muscle.getLength(self._state) for muscle in self._muscles]
            for index, coordinate in enumerate(self._coordinates):
                for muscle in self._by_opensim[index]:
                    arm_rows[index, muscle] = self._muscles[muscle].computeMomentArm(self._state, coordinate)
                if self._by_speed[index]:
                    self._set_unit_speed(coordinate)
                    for muscle in self._by_speed[index]:
                        arm_rows[index, muscle] = -self._muscles[muscle].getLengtheningSpeed(self._state)
        return length, moment_arm

    def analyse_placed(
        self, placements: Sequence[Mapping[str, WrapParameters]], poses: Float[np.ndarray, "pose coordinate"]
    ) -> tuple[
        Float[np.ndarray, "placement pose muscle"], Float[np.ndarray, "placement pose coordinate muscle"]
    ]:
        """Compute lengths (m) and moment arms (m) at poses for each placement of cylinders.

        Parameters
        ----------
        placements
            Wrap parameters by cylinder name for each placement (see `place`).
        poses
            Coordinate values, rad or m.
        """
        results = []
        for wraps in placements:
            self.place(wraps)
            results.append(self.analyse(poses))
        length, moment_arm = zip(*results, strict=True)
        return np.stack(length), np.stack(moment_arm)

    def place(self, wraps: Mapping[str, WrapParameters]) -> None:
        """Set the parameters of wrap objects.

        Parameters
        ----------
        wraps
            Wrap parameters by wrap name, in the order of `NominalSurface.place`. Others become nominal.
        """
        for name, surface in self._surfaces.items():
            surface.place(self._opensim, wraps.get(name, NOMINAL))
        self._state = self._model.initSystem()
        for coordinate in elements(self._model.getCoordinateSet()):
            coordinate.setValue(self._state, coordinate.getDefaultValue(), False)

    def touching(self, poses: Float[np.ndarray, "pose coordinate"]) -> set[int]:
        """Find the numbers of the muscles that touch a wrapping surface in at least one of the poses."""
        touching: set[int] = set()
        for pose in poses:
            self._set_pose(pose)
            self._model.realizePosition(self._state)
            for number, muscle in enumerate(self._muscles):
                if number not in touching and self._touches(muscle):
                    touching.add(number)
        return touching

    def _touches(self, muscle: Any) -> bool:
        # OpenSim removes the wrap points of a path that leaves a surface.
        points = muscle.getGeometryPath().getCurrentPath(self._state)
        wrapping = self._opensim.PathWrapPoint.safeDownCast
        return any(wrapping(points.get(place)) is not None for place in range(points.getSize()))

    def _set_pose(self, pose: Float[np.ndarray, " coordinate"]) -> None:
        state = self._state
        for coordinate, value in zip(self._coordinates, pose, strict=True):
            # False: the value is not clamped to its range, and the model is not assembled.
            coordinate.setValue(state, float(value), False)
        for dependent, independent, function, scale in self._couplers:
            inputs = self._vector([coordinate.getValue(state) for coordinate in independent])
            dependent.setValue(state, scale * function.calcValue(inputs), False)

    def _set_unit_speed(self, moving: Any) -> None:
        """Set unit speed of one coordinate and the resulting speeds of coupled ones; others are at rest."""
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


def _has_simple_path(muscle: Any) -> bool:
    """Whether OpenSim's moment arm of this path equals minus its lengthening speed."""
    path = muscle.getGeometryPath()
    fixed = all(point.getConcreteClassName() == "PathPoint" for point in elements(path.getPathPointSet()))
    return fixed and path.getWrapSet().getSize() <= 1
