"""Solver states on disk: checkpoints of an interrupted calibration, and the fingerprint of a solve."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.calibration.solvers.augmented_lagrangian import LagrangianState
from wrapjax.calibration.solvers.interface import AbstractLeastSquares, DampingState, Iteration, Status
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import new_folder, write_json
from wrapjax.io.json_and_arrays import load_json
from wrapjax.io.store import Store, fingerprint


@dataclass(frozen=True)
class Checkpoint:
    """State of one solve (a stage of a start, or a draw) of a calibration."""

    state: LagrangianState
    history: tuple[Iteration, ...]
    #: None while the solve is not finished.
    status: Status | None


@dataclass(frozen=True)
class Checkpoints:
    """Folder with the checkpoints of a calibration, one file for each solve.

    Every file is replaced atomically after each iteration, so that an interruption loses at most one
    iteration.

    Parameters
    ----------
    folder
        Folder of the files.
    """

    folder: Path

    @classmethod
    def open(cls, folder: Path, question: str, *, resume: bool) -> Checkpoints:
        """Open a folder with checkpoints to continue, or create an empty one.

        Parameters
        ----------
        folder
            Folder of the checkpoints.
        question
            Fingerprint of the calibration.
        resume
            Continue from the checkpoints in the folder; otherwise they are deleted.

        Raises
        ------
        InputError
            If ``resume`` is set and there are no checkpoints, or those of another calibration.
        """
        file = folder / "question.json"
        if resume:
            try:
                stored = load_json(file)["question"]
            except (OSError, ValueError, KeyError, TypeError):
                raise InputError(
                    Problem(str(folder), "holds no interrupted work to resume", hint="leave out --resume")
                ) from None
            if stored != question:
                raise InputError(
                    Problem(
                        str(folder),
                        "was begun with other data or settings",
                        hint="give the same ones, or leave out --resume to begin anew",
                    )
                )
        else:
            with new_folder(folder, force=True) as made:
                write_json(made / file.name, {"question": question})
        return cls(folder)

    def close(self) -> None:
        """Delete the checkpoints of a finished calibration."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def write(
        self,
        name: str,
        state: LagrangianState,
        history: Sequence[Iteration],
        status: Status | None = None,
    ) -> None:
        """Write the checkpoint of a solve; ``status`` is None while it is not finished."""
        arrays = {
            "variables": state.variables,
            "pace": np.array([state.damping_state.damping, state.damping_state.growth]),
            "gaps": np.array([state.constraint_residual, state.previous_residual]),
            "history": np.array([astuple(iteration) for iteration in history], dtype=float),
            "status": np.array("" if status is None else status.name),
        }
        arrays |= {f"shift_{number}": shift for number, shift in enumerate(state.shifts)}
        arrays |= {f"weight_{number}": weight for number, weight in enumerate(state.weights)}
        plain: dict[str, Any] = {key: np.asarray(value) for key, value in arrays.items()}
        Store(self.folder).write_arrays(name, **plain)

    def read(self, name: str) -> Checkpoint | None:
        """Read the checkpoint of a solve; None if there is none or it cannot be read."""
        arrays = Store(self.folder).read_arrays(name)
        if arrays is None:
            return None
        try:
            limits = sum(key.startswith("shift_") for key in arrays)
            state = LagrangianState(
                variables=jnp.asarray(arrays["variables"]),
                damping_state=DampingState(*map(jnp.asarray, arrays["pace"])),
                shifts=tuple(jnp.asarray(arrays[f"shift_{number}"]) for number in range(limits)),
                weights=tuple(jnp.asarray(arrays[f"weight_{number}"]) for number in range(limits)),
                constraint_residual=jnp.asarray(arrays["gaps"][0]),
                previous_residual=jnp.asarray(arrays["gaps"][1]),
            )
            history = tuple(_iteration(row) for row in arrays["history"])
            name_of_status = str(arrays["status"])
            return Checkpoint(state, history, Status[name_of_status] if name_of_status else None)
        except (KeyError, ValueError, TypeError, IndexError):
            return None


def _iteration(row: np.ndarray) -> Iteration:
    number, cost, optimality, damping, step, at_bounds, seconds = row.tolist()
    return Iteration(int(number), cost, optimality, damping, step, int(at_bounds), seconds)


def solve_fingerprint(
    problem: AbstractLeastSquares, start: Float[np.ndarray, " variable"], solver: ProjectedLevenbergMarquardt
) -> str:
    """Compute the hash of a solve: all numbers and the structure of its problem, start, solver and code."""
    problem = jax.tree.map(np.asarray, problem)
    # The structure has the names of functions; the arrays in them are among the leaves.
    structure = eqx.tree_pformat(problem)
    return fingerprint(structure, *jax.tree.leaves(problem), np.asarray(start), repr(solver))
