"""Problems of any size, made by repeating the arrays of a recorded one; and people who differ a little."""

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
from wrapjax.geometry.path_modes import PATH_CHANGE
from wrapjax.geometry.paths import AdjustablePath, PathState
from wrapjax.model.forward import Recording, muscle_states
from wrapjax.model.freedom import nga_freedom, with_paths
from wrapjax.model.parameters import ModelParameters
from wrapjax.model.variables import free_variables

#: Size of a made-up change of path, in parts of the path.
_MODE_SIZE = 0.01
#: How much made-up people differ, in parts of each number.
_SPREAD = 0.01


def tiled(problem: Objective, *, muscles: int, trials: int, modes: int = 0) -> Objective:
    """Repeat a problem's muscles and trials, or leave some out, until there are so many.

    It is a problem to be timed: the moments of repeated muscles have nothing to do with those measured.

    Parameters
    ----------
    problem
        Whose paths are held.
    muscles, trials
        How many there will be.
    modes
        How many changes of each path will be free, as in SGA: made-up ones.
    """
    present = len(problem.initial.emg_scale)
    chosen, cycles = np.arange(muscles) % present, np.arange(trials) % len(problem.measured)
    nominal = problem.recording.path.nominal
    held = PathState(nominal.length, nominal.velocity, nominal.moment_arm)
    emg, path = jax.tree.map(lambda leaf: leaf[chosen][:, cycles], (problem.recording.emg, held))
    base = jax.tree.map(lambda leaf: leaf[chosen], problem.initial)
    base = eqx.tree_at(lambda tree: tree.path_changes, base, jnp.zeros((muscles, modes)))
    recording = Recording(emg, AdjustablePath(path, _made_up_modes(path, modes)), problem.recording.padding)
    return _problem(problem, recording, base, problem.measured[cycles])


def another_person(problem: Objective, seed: int) -> Objective:
    """Make up a person of the same shape, in whom all that is recorded and every muscle is a little other."""
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
    """Put a problem together as `prepare` does: NGA, or SGA where paths have modes."""
    muscles, modes = base.path_changes.shape
    freedom = nga_freedom(base)
    if modes:
        freedom = with_paths(freedom, "SGA", np.ones((muscles, modes), dtype=bool), prior_sd=PATH_CHANGE)
    reference = eqx.filter_jit(muscle_states)(like.curves, base, recording)
    own = tuple(dict.fromkeys(label.rsplit(".", 1)[0] for label in like.variables.labels))
    present = len(own)
    # The first ones keep their names: programs are compiled for names, too.
    names = [own[one % present] + (f"_{one // present}" if one >= present else "") for one in range(muscles)]
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
    """Repeat groups with their members; those that are left with one member are none."""
    copies = -(-muscles // present)
    moved = [[copy * present + one for one in group] for copy in range(copies) for group in groups]
    kept = (tuple(one for one in group if one < muscles) for group in moved)
    return tuple(group for group in kept if len(group) > 1)


def _made_up_modes(path: PathState, count: int) -> PathState:
    """Waves along the cycle, in parts of the path: as dense as recorded modes, which is what takes time."""
    frames = path.length.shape[-1]
    waves = np.cos(np.pi * np.arange(1, count + 1)[:, None] * np.linspace(0.0, 1.0, frames))

    def along(leaf: Array) -> Array:
        shape = (1, count, *(1,) * (leaf.ndim - 2), frames)
        return _MODE_SIZE * leaf[:, None] * waves.reshape(shape)

    return jax.tree.map(along, path)
