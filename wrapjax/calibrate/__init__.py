"""Calibration: objective, limits, solvers, starts and result."""

from wrapjax.calibrate.augmented_lagrangian import AugmentedLagrangian as AugmentedLagrangian
from wrapjax.calibrate.augmented_lagrangian import ConstrainedSolution as ConstrainedSolution
from wrapjax.calibrate.augmented_lagrangian import LagrangianState as LagrangianState
from wrapjax.calibrate.identifiability import laplace_deviation as laplace_deviation
from wrapjax.calibrate.journal import Journal as Journal
from wrapjax.calibrate.lbfgs import BoundedLBFGS as BoundedLBFGS
from wrapjax.calibrate.legs import join_legs as join_legs
from wrapjax.calibrate.legs import solution_of_leg as solution_of_leg
from wrapjax.calibrate.multistart import Outcome as Outcome
from wrapjax.calibrate.multistart import Watch as Watch
from wrapjax.calibrate.multistart import best as best
from wrapjax.calibrate.multistart import solve_from_starts as solve_from_starts
from wrapjax.calibrate.multistart import starting_points as starting_points
from wrapjax.calibrate.objective import Objective as Objective
from wrapjax.calibrate.path_restraints import FIBER_LENGTH_RANGE as FIBER_LENGTH_RANGE
from wrapjax.calibrate.path_restraints import PATH_CHANGE as PATH_CHANGE
from wrapjax.calibrate.path_restraints import path_limits as path_limits
from wrapjax.calibrate.path_restraints import path_modes as path_modes
from wrapjax.calibrate.penalties import pipeline_penalties as pipeline_penalties
from wrapjax.calibrate.problem import AbstractCalibration as AbstractCalibration
from wrapjax.calibrate.projected_lm import ProjectedLM as ProjectedLM
from wrapjax.calibrate.result import CalibrationResult as CalibrationResult
from wrapjax.calibrate.solution import Iteration as Iteration
from wrapjax.calibrate.solution import Pace as Pace
from wrapjax.calibrate.solution import Solution as Solution
from wrapjax.calibrate.solution import Status as Status
