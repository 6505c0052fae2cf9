"""Calibration problems of any size, by repetition of a recorded one, and slightly perturbed problems."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.path_penalties import path_limits
from wrapjax.calibration.penalties import GroupPenalty, pipeline_penalties
from wrapjax.geometry.paths import AdjustablePath, PathState
from wrapjax.model.forward import Recording, muscle_states
from wrapjax.model.freedom import nga_freedom, with_paths
from wrapjax.model.parameters import ModelParameters
from wrapjax.model.variables import free_variables
from wrapjax.path_sources.polynomial_paths import PATH_CHANGE

#: Amplitude of a synthetic path mode, relative to the path.
_MODE_SIZE = 0.01
#: Relative standard deviation of the numbers of perturbed problems.
_SPREAD = 0.01


def tile_problem(problem: Objective, *, muscles: int, trials: int, modes: int = 0) -> Objective:
    """Build a problem with given numbers of muscles and trials by repeating or omitting those of another.

    The problem is meant for timing only: the moments of repeated muscles do not fit the measured ones.

    Parameters
    ----------
    problem
        Problem with fixed paths.
    muscles, trials
        Numbers of muscles and trials of the new problem.
    modes
        Number of free synthetic modes of each path, as in SGA.
    """
    present = len(problem.initial.emg_scale)
    chosen, cycles = np.arange(muscles) % present, np.arange(trials) % len(problem.measured)
    nominal = problem.recording.path.nominal
    held = PathState(nominal.length, nominal.velocity, nominal.moment_arm)
    emg, path = jax.tree.map(lambda leaf: leaf[chosen][:, cycles], (problem.recording.emg, held))
    base = jax.tree.map(lambda leaf: leaf[chosen], problem.initial)
    base = eqx.tree_at(lambda tree: tree.path_changes, base, jnp.zeros((muscles, modes)))
    recording = Recording(emg, AdjustablePath(path, _synthetic_modes(path, modes)), problem.recording.padding)
    return _problem(problem, recording, base, problem.measured[cycles])


def perturb_problem(problem: Objective, seed: int) -> Objective:
    """Build a problem of the same shape with slightly different recordings and muscle parameters."""
    generator = np.random.default_rng(seed)

    def changed(leaf: Array) -> Array:
        return leaf * (1.0 + _SPREAD * generator.standard_normal(leaf.shape))

    def lengths(tree: ModelParameters) -> list[Array]:
        return [tree.optimal_fiber_length, tree.tendon_slack_length, tree.max_isometric_force]

    recording = jax.tree.map(changed, problem.recording)
    base = eqx.tree_at(lengths, problem.initial, replace_fn=changed)
    return _problem(problem, recording, base, changed(problem.measured))


def _problem(
    like: Objective,
    recording: Recording,
    base: ModelParameters,
    measured: Float[Array, "trial coordinate frame"],
) -> Objective:
    """Build an NGA problem, or an SGA problem if the paths have modes."""
    muscles, modes = base.path_changes.shape
    freedom = nga_freedom(base)
    if modes:
        freedom = with_paths(freedom, "SGA", np.ones((muscles, modes), dtype=bool), prior_sd=PATH_CHANGE)
    reference = eqx.filter_jit(muscle_states)(like.curves, base, recording)
    present_names = tuple(dict.fromkeys(label.rsplit(".", 1)[0] for label in like.variables.labels))
    present = len(present_names)
    # The first muscles keep their names: names are part of what a program is compiled for.
    names = [
        present_names[index % present] + (f"_{index // present}" if index >= present else "")
        for index in range(muscles)
    ]
    return Objective(
        curves=like.curves,
        recording=recording,
        measured=measured,
        variables=free_variables(base, freedom, names),
        penalties=pipeline_penalties(
            reference,
            _tiled_groups(_groups(like, "grouped_emg_scale"), present, muscles),
            _tiled_groups(_groups(like, "grouped_fiber_length_mean"), present, muscles),
        ),
        limits=path_limits(recording.path.nominal) if modes else (),
    )


def _groups(problem: Objective, name: str) -> tuple[tuple[int, ...], ...]:
    found = (one for one in problem.penalties if isinstance(one, GroupPenalty) and one.name == name)
    return next((one.groups for one in found), ())


def _tiled_groups(groups: Sequence[Sequence[int]], present: int, muscles: int) -> tuple[tuple[int, ...], ...]:
    """Repeat groups for the repeated muscles, and drop groups with a single member left."""
    copies = -(-muscles // present)
    moved = [[copy * present + one for one in group] for copy in range(copies) for group in groups]
    present_groups = (tuple(one for one in group if one < muscles) for group in moved)
    return tuple(group for group in present_groups if len(group) > 1)


def _synthetic_modes(path: PathState, count: int) -> PathState:
    """Build cosine modes along the cycle, relative to the path and as dense as the modes of SGA."""
    frames = path.length.shape[-1]
    waves = np.cos(np.pi * np.arange(1, count + 1)[:, None] * np.linspace(0.0, 1.0, frames))

    def along(leaf: Array) -> Array:
        shape = (1, count, *(1,) * (leaf.ndim - 2), frames)
        return _MODE_SIZE * leaf[:, None] * waves.reshape(shape)

    return jax.tree.map(along, path)
