"""Calibration: objective, solver and result."""

from wrapjax.calibrate.identifiability import laplace_deviation as laplace_deviation
from wrapjax.calibrate.objective import Objective as Objective
from wrapjax.calibrate.penalties import pipeline_penalties as pipeline_penalties
from wrapjax.calibrate.projected_lm import Iteration as Iteration
from wrapjax.calibrate.projected_lm import ProjectedLM as ProjectedLM
from wrapjax.calibrate.projected_lm import Solution as Solution
from wrapjax.calibrate.projected_lm import Status as Status
from wrapjax.calibrate.result import CalibrationResult as CalibrationResult
