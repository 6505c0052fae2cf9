"""Calibration problem that the benchmarks time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import wrapjax
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.problem import build_objective
from wrapjax.model.forward import joint_moments
from wrapjax.path_sources.model_inputs import recording, surrogate_paths
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.subject.subject import Subject


@dataclass(frozen=True)
class Case:
    """Subject with its path fit and its NGA calibration problem."""

    subject: Subject
    fit: Fit
    problem: Objective

    @property
    def size(self) -> str:
        """Number of variables and of moment residuals, as text."""
        return f"{self.problem.variables.count} variables, {self.problem.measured.size:,} moment residuals"

    @property
    def start(self) -> Float[Array, " variable"]:
        """Starting point of every optimizer."""
        return self.problem.variables.start()

    def compiled(self, function: Callable[[Objective, Array], Any]) -> Callable[[Any], Any]:
        """Compile a function of problem and variables as a function of the variables.

        The problem's arrays are arguments of the program: XLA would fold constants for minutes.
        """
        return eqx.Partial(eqx.filter_jit(function), self.problem)

    def moment_mae(self, variables: Float[Array | np.ndarray, " variable"]) -> dict[str, float]:
        """Compute the mean absolute moment error (N m) of calibration and of validation trials."""
        trials = self.subject.trials
        inputs = recording(self.subject, trials, surrogate_paths(self.fit.surrogate, self.subject, trials))
        parameters = self.problem.variables.unpack(jnp.asarray(variables))
        modelled = eqx.filter_jit(joint_moments)(self.problem.curves, parameters, inputs)
        error = np.abs(np.asarray(modelled) - trials.moments).mean(axis=(1, 2))
        uses = np.array(trials.uses)
        return {use: float(error[uses == use].mean()) for use in sorted(set(uses.tolist()))}


def nga_case(subject: Subject) -> Case:
    """Fit the subject's paths, or read them from the cache, and build its NGA problem."""
    fit = wrapjax.fit(subject, quiet=False)
    return Case(subject, fit, build_objective(subject, "NGA", fit))


def total_cost(problem: Objective, variables: Float[Array, " variable"]) -> Float[Array, ""]:
    """Compute the sum of squares of all residuals."""
    return jnp.sum(problem.residuals(variables) ** 2)


def moment_residuals(problem: Objective, variables: Float[Array, " variable"]) -> Float[Array, " row"]:
    """Compute the residuals of the joint moments alone."""
    return problem.terms(problem.variables.unpack(variables))["joint_moment"]
