"""Recorded motions, and OpenSim models in their poses with velocities and accelerations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.osim.model import couplers_of, elements, independent_names


@dataclass(frozen=True)
class Motion:
    """Motion of a model as values and derivatives of its coordinates.

    Parameters
    ----------
    coordinates
        Names of independent coordinates. Others stay at the model's defaults, and locked ones where the model
        holds them; coordinates coupled to a single other one follow it.
    values, speeds, accelerations
        Values (rad or m) and their first and second time derivatives (per s and s^2).
    """

    coordinates: tuple[str, ...]
    values: Float[np.ndarray, "coordinate pose"]
    speeds: Float[np.ndarray, "coordinate pose"]
    accelerations: Float[np.ndarray, "coordinate pose"]


class Mover:
    """Sets values and speeds of a state's coordinates, and orders accelerations as Simbody does.

    Parameters
    ----------
    opensim
        The imported package.
    model, state
        OpenSim's model and its state.
    moving
        OpenSim's coordinates to be set, in the order of the arguments of `move`.
    """

    def __init__(self, opensim: Any, model: Any, state: Any, moving: Sequence[Any]):
        self._opensim, self._model, self._state = opensim, model, state
        # Locked coordinates stay where the model holds them; OpenSim raises an error if they are set.
        self._moving = [(row, entry) for row, entry in enumerate(moving) if not entry.get_locked()]
        entries = model.getCoordinateSet()
        self._couplers = [
            (
                entries.get(coupler.getDependentCoordinateName()),
                entries.get(independent_names(coupler)[0]),
                coupler.getFunction(),
                float(coupler.getPropertyByName("scale_factor").toString()),
            )
            for coupler in couplers_of(opensim, model)
            if len(independent_names(coupler)) == 1
        ]
        self._columns = {entry.getName(): self.column(entry) for entry in elements(entries)}

    def column(self, coordinate: Any) -> int:
        """Find the index of a coordinate among the system's mobilities, whose order is not the model's."""
        before = self._state.getU().to_numpy()
        self._state.setU(self._opensim.Vector(self._state.getNU(), 0.0))
        coordinate.setSpeedValue(self._state, 1.0)
        place = int(np.argmax(self._state.getU().to_numpy()))
        self._state.setU(self._opensim.Vector.createFromMat(before))
        return place

    def move(
        self,
        values: Float[np.ndarray, " coordinate"],
        speeds: Float[np.ndarray, " coordinate"],
        accelerations: Float[np.ndarray, " coordinate"],
    ) -> Float[np.ndarray, " mobility"]:
        """Set the state, realized to velocities, and return all accelerations in the order of mobilities.

        Parameters
        ----------
        values, speeds, accelerations
            Value (rad or m), speed and acceleration of each coordinate in ``moving``.
        """
        state, opensim = self._state, self._opensim
        rates = np.zeros(state.getNU())
        for row, coordinate in self._moving:
            # False: the value is not clamped to its range, and the model is not assembled.
            coordinate.setValue(state, float(values[row]), False)
            coordinate.setSpeedValue(state, float(speeds[row]))
            rates[self._columns[coordinate.getName()]] = accelerations[row]
        for dependent, independent, function, scale in self._couplers:
            at = opensim.Vector(1, independent.getValue(state))
            speed = independent.getSpeedValue(state)
            first = scale * function.calcDerivative(opensim.StdVectorInt([0]), at)
            second = scale * function.calcDerivative(opensim.StdVectorInt([0, 0]), at)
            dependent.setValue(state, scale * function.calcValue(at), False)
            dependent.setSpeedValue(state, first * speed)
            rates[self._columns[dependent.getName()]] = (
                first * rates[self._columns[independent.getName()]] + second * speed**2
            )
        self._model.realizeVelocity(state)
        return rates
