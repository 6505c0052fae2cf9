"""A small synthetic calibration with chosen errors, not computed by the package."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from tests.calibration.fixtures import calibrated as calibrated
from tests.calibration.fixtures import paths as paths
from tests.calibration.fixtures import person as person
from tests.model.small import small_objective
from tests.report.solutions import with_solution
from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.calibration.solvers.augmented_lagrangian import (
    AugmentedLagrangian,
    ConstrainedSolution,
    LagrangianState,
)
from wrapjax.calibration.solvers.interface import DampingState, Iteration, Linearization, Status
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.geometry.paths import PathState
from wrapjax.geometry.surrogates.surrogate import PathSurrogate, fit_surrogate
from wrapjax.io.model_file import MuscleParameters
from wrapjax.model.forward import MuscleState
from wrapjax.model.freedom import Freedom, FreedParameter
from wrapjax.model.parameters import ModelParameters
from wrapjax.model.variables import free_variables
from wrapjax.muscle.hill import FiberState
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

MUSCLES = ("iliacus_l", "soleus_l")
COORDINATES = ("hip_flexion_l", "ankle_angle_l")
TRIALS = ("slow", "walk/02", "fast")
USES = ("calibration", "calibration", "validation")
FRAMES = 5


def _errors():
    """Modelled minus measured moment in N m: trial, coordinate, frame."""
    return np.array(
        [
            [[1.0] * 5, [-2.0] * 5],
            [[3.0] * 5, [0.0, 0.0, 0.0, 0.0, 20.0]],
            [[5.0] * 5, [7.0] * 5],
        ]
    )


def _measured():
    generator = np.random.default_rng(20)
    return generator.normal(scale=30.0, size=(3, 2, FRAMES))


def _time():
    return np.linspace([0.0, 1.0, 2.0], [0.9, 1.9, 2.9], FRAMES, axis=1)


def _parameters(**changed) -> ModelParameters:
    values = {
        "electromechanical_delay": [0.05, 0.05],
        "activation_time_constant": [0.015, 0.015],
        "activation_nonlinearity": [0.05, 0.05],
        "emg_scale": [0.5, 0.5],
        "optimal_fiber_length": [0.1, 0.05],
        "tendon_slack_length": [0.09, 0.25],
        "max_isometric_force": [1073.0, 6195.0],
        "pennation_angle": [0.25, 0.38],
        "max_fiber_velocity": [10.0, 10.0],
        "path_changes": np.zeros((2, 0)),
    } | changed
    return ModelParameters(**{name: jnp.array(value) for name, value in values.items()})


def _states(shift: float) -> MuscleState:
    frames = jnp.arange(2 * 3 * FRAMES, dtype=float).reshape(2, 3, FRAMES)
    return MuscleState(
        excitation=frames / 100.0,
        activation=frames / 50.0,
        path=_path(shift / 100.0),
        fiber=FiberState(
            normalized_length=0.8 + shift + frames / 1000.0,
            normalized_velocity=jnp.zeros_like(frames),
            active_force=100.0 + frames,
            passive_force=jnp.full_like(frames, 0.125),
        ),
        moment=jnp.zeros((2, 3, 2, FRAMES)),
    )


def _freed(name: str, lower: list[float], upper: list[float]) -> FreedParameter:
    ones = np.ones(2)
    return FreedParameter(name, np.array(lower), np.array(upper), ones, 0.5 * ones, np.inf * ones)


def _freedom() -> Freedom:
    return Freedom(
        "NGA",
        (
            _freed("emg_scale", [0.05, 0.05], [1.0, 1.0]),
            _freed("optimal_fiber_length", [0.06, 0.03], [0.14, 0.07]),
        ),
    )


def _solution() -> ConstrainedSolution:
    history = tuple(
        Iteration(number, cost, optimality, 1e-3, 0.1, 1, 0.25 * number)
        for number, (cost, optimality) in enumerate([(80.0, 2.0), (12.0, 0.1), (9.0, 0.0)])
    )
    square = jnp.eye(4)
    variables = np.array([0.05, 0.06, 0.4, 0.07])
    damping_state = DampingState(jnp.array(1e-6), jnp.array(2.0))
    # Only the assignment of variables to parameters matters here, not the cost.
    problem = replace(small_objective(), variables=free_variables(_parameters(), _freedom(), MUSCLES))
    return ConstrainedSolution(
        variables=variables,
        cost=9.0,
        status=Status.gradient,
        linearization=Linearization(jnp.array(9.0), jnp.zeros(4), square, square),
        damping_state=damping_state,
        history=history,
        max_violation=0.0,
        problem=problem,
        state=LagrangianState(
            jnp.asarray(variables), damping_state, (), (), jnp.array(0.0), jnp.array(jnp.inf)
        ),
    )


def _path(shift: float) -> PathState:
    """Paths of two muscles of one coordinate each; ``shift`` (m) is added to lengths and moment arms."""
    length = jnp.full((2, 3, FRAMES), 0.3 + shift)
    arm = jnp.zeros((2, 3, 2, FRAMES)).at[0, :, 0].set(0.04 + shift).at[1, :, 1].set(-0.05 + shift)
    return PathState(length, jnp.zeros_like(length), arm)


def _nominal_paths() -> PathSurrogate:
    poses = np.random.default_rng(3).uniform(-0.5, 0.5, (60, 2))
    length = 0.3 - 0.04 * poses
    arm = np.zeros((60, 2, 2))
    arm[:, 0, 0] = arm[:, 1, 1] = 0.04
    spans = {muscle: (name,) for muscle, name in zip(MUSCLES, COORDINATES, strict=True)}
    return fit_surrogate(MUSCLES, COORDINATES, spans, poses, length, arm)


@pytest.fixture
def result() -> CalibrationResult:
    measured = _measured()
    return CalibrationResult(
        method="NGA",
        muscles=MUSCLES,
        coordinates=COORDINATES,
        trials=TRIALS,
        uses=USES,
        speeds=np.array([0.5, 0.5, 0.8]),
        tasks=("gait",) * 3,
        recordings=TRIALS,
        time=_time(),
        initial=_parameters(),
        # One third has no short decimal form, which tests that files keep all digits.
        parameters=_parameters(emg_scale=[0.05, 1.0 / 3.0], optimal_fiber_length=[0.11, 0.07]),
        freedom=_freedom(),
        at_bounds=("iliacus_l.emg_scale", "soleus_l.optimal_fiber_length"),
        labels=(
            "iliacus_l.emg_scale",
            "iliacus_l.optimal_fiber_length",
            "soleus_l.emg_scale",
            "soleus_l.optimal_fiber_length",
        ),
        geometry="engine",
        paths=_nominal_paths(),
        calibrated_paths=_nominal_paths(),
        measured=measured,
        modelled=measured + _errors(),
        initial_modelled=measured + 20.0,
        states=_states(0.0),
        initial_states=_states(0.6),
        cost_by_term={"joint_moment": 7.0, "passive_force": 1.5, "prior": 0.5},
        curves="paper",
        tendon="rigid",
        muscle_law="nmsm",
        solver=AugmentedLagrangian(),
        outcomes=(Outcome(None, np.array([0.05, 0.05, 0.5, 0.05]), _solution()),),
        chosen=0,
        n_residuals=20,
        compile_seconds=1.5,
    )


@pytest.fixture
def without_validation(result) -> CalibrationResult:
    return replace(result, uses=("calibration",) * 3)


@pytest.fixture
def not_finite(result) -> CalibrationResult:
    """Result of a solver for which the cost was not finite at the start."""
    failed = Iteration(0, float("nan"), float("nan"), 1e-3, 0.0, 0, 0.0)
    return replace(
        with_solution(result, status=Status.not_finite, history=(failed,), cost=float("nan")),
        modelled=np.full_like(result.modelled, np.nan),
        states=MuscleState(
            result.states.excitation,
            jnp.full_like(result.states.activation, jnp.nan),
            result.states.path,
            result.states.fiber,
            result.states.moment,
        ),
        cost_by_term={"joint_moment": float("nan"), "prior": 0.5},
    )


@pytest.fixture
def subject() -> Subject:
    padded = np.zeros((3, 2, FRAMES + 2))
    angles = np.zeros((3, 2, FRAMES))
    trials = Trials(
        names=TRIALS,
        recordings=("slow", "walk", "fast"),
        uses=USES,
        speeds=np.array([0.5, 0.5, 0.8]),
        coordinates=COORDINATES,
        moment_coordinates=COORDINATES,
        channels=("hip", "calf"),
        time=_time(),
        angles=angles,
        angular_velocities=angles,
        moments=_measured(),
        emg_time=np.zeros((3, FRAMES + 2)),
        emg=padded,
    )
    return Subject(
        name="made_by_hand",
        mass_kg=70.0,
        side="l",
        paretic=None,
        folder=Path("subjects/made_by_hand"),
        model_file=Path("subjects/made_by_hand/model.osim"),
        other_leg=None,
        muscles=MuscleParameters(
            MUSCLES,
            np.array([1073.0, 6195.0]),
            np.array([0.1, 0.05]),
            np.array([0.09, 0.25]),
            np.array([0.25, 0.38]),
        ),
        muscle_channels=(0, 1),
        activation_groups=(),
        fiber_length_groups=(),
        undriven_muscles=("piri_l", "sart_l"),
        trials=trials,
        recordings=(),
        emg_rates=(),
        notes=("negative values were set to 0 in calf",),
    )
