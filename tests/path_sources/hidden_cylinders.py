"""Calibrating to moments that hide where cylinders are: what is shared by the tests of it.

Data of the model's own form, without noise: a unit test of PGA, not an accuracy. Which moment arms can be
told from gains is settled before anything is calibrated: those that moment noise of `NOISE` would leave, by
Laplace at the truth with everything else that is free, a standard deviation below a tenth of how far the
nominal arm is from the true one.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.calibration.uncertainty.identifiability import moment_arm_deviation
from wrapjax.demonstration.wrap_recovery import IDENTIFIABLE_RATIO
from wrapjax.geometry.wrapping import NOMINAL
from wrapjax.model.forward import joint_moments

#: N m.
NOISE = 0.003
#: Arms that are nearer than this (m) to the true ones from the start show nothing.
LEAST = 1e-4
#: With penalties weak from the start the nearest minimum is a poor one: they are weakened in steps, until
#: they weigh less than noise of `NOISE` would in all the samples of a subject.
MOMENT_ERRORS = (2.5, 0.5, 0.1, 0.02, 4e-3, 8e-4, 1.6e-4, 8e-5)
#: Where they are weakened from. Penalties that are strong at first can draw a cylinder to the wrong end of
#: its box for good; then they are weak from the start.
BEGINNINGS = (0, 3)
#: A step need not reach its minimum: the next one goes on from where it ends.
SOLVER = ProjectedLevenbergMarquardt(max_iterations=60)


def hidden(problem, wraps, true_wraps, **true):
    """Give a problem the moments of true parameters and cylinders; return it and the true tree."""
    moved = np.stack([true_wraps[name] - NOMINAL for name in wraps.names])
    changes = np.where((wraps.places >= 0)[..., None], moved[wraps.places], 0.0)
    values = {name: jnp.asarray(values) for name, values in true.items()}
    path_changes = jnp.asarray(changes.reshape(len(changes), -1))
    tree = dataclasses.replace(problem.variables.base, path_changes=path_changes, **values)
    moments = eqx.filter_jit(joint_moments)(problem.curves, tree, problem.recording)
    return dataclasses.replace(problem, measured=moments), tree


def errors_of_told_arms(problem, true):
    """Calibrate, and give errors (m) before and after of the arms that can be told apart, one after another.

    Errors are means over cycles and frames.
    """

    def arms(tree):
        return np.asarray(eqx.filter_jit(problem.recording.path.at)(tree.path_changes).moment_arm)

    def error(tree):
        return np.abs(arms(tree) - arms(true)).mean(axis=(1, 3))

    before = error(problem.variables.unpack(problem.variables.start()))
    deviation = moment_arm_deviation(problem, problem.variables.pack(true), NOISE).mean(axis=(1, 3))
    told = (before > LEAST) & (deviation < IDENTIFIABLE_RATIO * before)
    return before[told], error(calibrated(problem))[told]


def calibrated(problem):
    """Calibrate from one beginning after the other until moments are explained; give the tree that does best.

    As calibrations do with starts: several minima are normal, and moments say which is the better one.
    """
    found = []
    for beginning in BEGINNINGS:
        variables = problem.variables.start()
        for moment_error in MOMENT_ERRORS[beginning:]:
            step = dataclasses.replace(problem, moment_error=np.array(moment_error))
            variables = jnp.asarray(SOLVER.solve(step, variables).variables)
        tree = problem.variables.unpack(variables)
        rows = eqx.filter_jit(problem.terms)(tree)["joint_moment"]
        found.append((float(problem.moment_error * jnp.linalg.norm(rows)), tree))
        if found[-1][0] < NOISE:
            break
    return min(found, key=lambda one: one[0])[1]
