"""A recorded motion, and an OpenSim model that is put through it pose by pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.osim.model import couplers_of, elements, independent_names


@dataclass(frozen=True)
class Motion:
    """How a model moved, as OpenSim is told.

    Parameters
    ----------
    coordinates
        Independent ones. The others stay at the model's defaults, locked ones where they are held; those
        coupled to one other follow it.
    values, speeds, accelerations
        rad (or m), and per s and s^2.
    """

    coordinates: tuple[str, ...]
    values: Float[np.ndarray, "coordinate pose"]
    speeds: Float[np.ndarray, "coordinate pose"]
    accelerations: Float[np.ndarray, "coordinate pose"]


class Mover:
    """Sets a state's coordinates, their speeds, and gives their accelerations in Simbody's order."""

    def __init__(self, opensim: Any, model: Any, state: Any, moving: Sequence[Any]):
        self._opensim, self._model, self._state = opensim, model, state
        # Locked coordinates stay where the model holds them, and refuse to be set.
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
        """Find a coordinate's place among the system's mobilities, which are in an order of their own."""
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
    ) -> Any:
        """Put the state there, realized to velocities, and return all accelerations."""
        state, opensim = self._state, self._opensim
        rates = np.zeros(state.getNU())
        for row, coordinate in self._moving:
            # False: neither clamped to its range nor assembled.
            coordinate.setValue(state, float(values[row]), False)
            coordinate.setSpeedValue(state, float(speeds[row]))
            rates[self._columns[coordinate.getName()]] = accelerations[row]
        for dependent, leader, function, scale in self._couplers:
            at = opensim.Vector(1, leader.getValue(state))
            speed = leader.getSpeedValue(state)
            slope = scale * function.calcDerivative(opensim.StdVectorInt([0]), at)
            bend = scale * function.calcDerivative(opensim.StdVectorInt([0, 0]), at)
            dependent.setValue(state, scale * function.calcValue(at), False)
            dependent.setSpeedValue(state, slope * speed)
            rates[self._columns[dependent.getName()]] = (
                slope * rates[self._columns[leader.getName()]] + bend * speed**2
            )
        self._model.realizeVelocity(state)
        return opensim.Vector.createFromMat(rates)
