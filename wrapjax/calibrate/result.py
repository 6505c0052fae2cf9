"""What a calibration found, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.calibrate.augmented_lagrangian import AugmentedLagrangian, ConstrainedSolution
from wrapjax.calibrate.multistart import Outcome
from wrapjax.geometry import PathSurrogate
from wrapjax.model import Freedom, ModelParameters, MuscleState


@dataclass(frozen=True)
class CalibrationResult:
    """A calibrated model and how it behaves on every recorded cycle.

    Parameters
    ----------
    method
        Name of the freedom.
    muscles, coordinates, trials
        Names along the axes; ``uses`` says what each trial was for, ``speeds`` is in m/s (NaN: unknown).
    time
        Of every frame, in s.
    initial, parameters
        Before and after calibration.
    freedom
        What was free, with its bounds.
    at_bounds
        Variables that ended on a bound, as ``soleus_l.emg_scale``.
    labels
        Names of the variables.
    geometry
        Where paths came from: ``opensim``, ``engine`` or ``engine-parity``.
    paths, calibrated_paths
        As polynomials, before and after calibration; None where paths are exact.
    measured, modelled, initial_modelled
        Joint moments in N m; the last before calibration.
    states, initial_states
        All muscles over all cycles.
    cost_by_term
        The parts of the cost at the solution.
    curves
        Name of the Hill curves.
    tendon
        Kind of tendon.
    outcomes, chosen
        Where each start led, and the number of the one that was taken.
    solver
        With its tolerances.
    n_residuals
        Number of measured moments that were matched.
    compile_seconds
        Time that went into compiling, apart from solving.
    """

    method: str
    muscles: tuple[str, ...]
    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    uses: tuple[str, ...]
    speeds: Float[np.ndarray, " trial"]
    time: Float[np.ndarray, "trial frame"]
    initial: ModelParameters
    parameters: ModelParameters
    freedom: Freedom
    at_bounds: tuple[str, ...]
    labels: tuple[str, ...]
    geometry: str
    paths: PathSurrogate | None
    calibrated_paths: PathSurrogate | None
    measured: Float[np.ndarray, "trial coordinate frame"]
    modelled: Float[np.ndarray, "trial coordinate frame"]
    initial_modelled: Float[np.ndarray, "trial coordinate frame"]
    states: MuscleState
    initial_states: MuscleState
    cost_by_term: dict[str, float]
    curves: str
    tendon: str
    solver: AugmentedLagrangian
    outcomes: tuple[Outcome, ...]
    chosen: int
    n_residuals: int
    compile_seconds: float

    @property
    def solution(self) -> ConstrainedSolution:
        """Of the start that was taken."""
        return self.outcomes[self.chosen].solution

    @property
    def solve_seconds(self) -> float:
        """Time that went into solving from all starts, compiling apart."""
        return sum(outcome.seconds for outcome in self.outcomes)
