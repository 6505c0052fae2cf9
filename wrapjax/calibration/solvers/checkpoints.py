"""What an interrupted calibration leaves behind, to go on from.

Solves that are kept: whatever stops work that needs many, at most the one under way is lost.
"""

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
from wrapjax.io.files import code_hash, content_hash, new_folder, write_atomically, write_json
from wrapjax.io.json_and_arrays import load_arrays, load_json


@dataclass(frozen=True)
class Entry:
    """Where one stage of one start stands."""

    state: LagrangianState
    history: tuple[Iteration, ...]
    #: None while it is under way.
    status: Status | None


@dataclass(frozen=True)
class Checkpoints:
    """A folder with one file for each stage of each start.

    Every file is replaced whole after each iteration, so that whatever stops the process, what is
    there can be read and at most one step is lost.
    """

    folder: Path

    @classmethod
    def open(cls, folder: Path, question: str, *, resume: bool) -> Checkpoints:
        """Open a folder to go on with, or make a new one.

        Parameters
        ----------
        folder
            Where it is.
        question
            Names the calibration: data, method, settings. A journal of another is refused.
        resume
            Go on with what is there; otherwise it is thrown away.

        Raises
        ------
        InputError
            If there is nothing to resume, or it belongs to another calibration.
        """
        file = folder / "question.json"
        if resume:
            try:
                found = load_json(file)["question"]
            except (OSError, ValueError, KeyError, TypeError):
                raise InputError(
                    Problem(str(folder), "holds no interrupted work to resume", hint="leave out --resume")
                ) from None
            if found != question:
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
        """Throw the journal away: the work is done."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def write(
        self,
        name: str,
        state: LagrangianState,
        history: Sequence[Iteration],
        status: Status | None = None,
    ) -> None:
        """Keep where a stage stands."""
        arrays = {
            "variables": state.variables,
            "pace": np.array([state.damping_state.damping, state.damping_state.growth]),
            "gaps": np.array([state.gap, state.gap_before]),
            "history": np.array([astuple(iteration) for iteration in history], dtype=float),
            "status": np.array("" if status is None else status.name),
        }
        arrays |= {f"shift_{number}": shift for number, shift in enumerate(state.shifts)}
        arrays |= {f"weight_{number}": weight for number, weight in enumerate(state.weights)}
        plain: dict[str, Any] = {key: np.asarray(value) for key, value in arrays.items()}
        write_atomically(self.folder / f"{name}.npz", lambda path: np.savez(path, **plain))

    def read(self, name: str) -> Entry | None:
        """Find where a stage stands; None if it was never begun, or what is there cannot be read."""
        try:
            kept = load_arrays(self.folder / f"{name}.npz")
            limits = sum(key.startswith("shift_") for key in kept)
            state = LagrangianState(
                variables=jnp.asarray(kept["variables"]),
                damping_state=DampingState(*map(jnp.asarray, kept["pace"])),
                shifts=tuple(jnp.asarray(kept[f"shift_{number}"]) for number in range(limits)),
                weights=tuple(jnp.asarray(kept[f"weight_{number}"]) for number in range(limits)),
                gap=jnp.asarray(kept["gaps"][0]),
                gap_before=jnp.asarray(kept["gaps"][1]),
            )
            history = tuple(_iteration(row) for row in kept["history"])
            name_of_status = str(kept["status"])
            return Entry(state, history, Status[name_of_status] if name_of_status else None)
        except (OSError, KeyError, ValueError, TypeError, IndexError):
            return None


def _iteration(row: np.ndarray) -> Iteration:
    number, cost, optimality, damping, step, at_bounds, seconds = row.tolist()
    return Iteration(int(number), cost, optimality, damping, step, int(at_bounds), seconds)


@dataclass(frozen=True)
class SolveCache:
    """A folder with one file for each solve, named by all that decides where it ends.

    Parameters
    ----------
    folder
        Where it is.
    """

    folder: Path

    def read(self, name: str) -> tuple[Float[np.ndarray, " variable"], Status] | None:
        """Find where a solve ended, and why; None if it was not done, or what is there cannot be read."""
        try:
            kept = load_arrays(self.folder / f"{name}.npz")
            return kept["variables"], Status[str(kept["status"])]
        except (OSError, ValueError, KeyError):
            return None

    def write(self, name: str, variables: Float[np.ndarray, " variable"], status: Status) -> None:
        """Keep where a solve ended."""
        write_atomically(
            self.folder / f"{name}.npz",
            lambda path: np.savez(path, variables=variables, status=np.array(status.name)),
        )


def solve_fingerprint(
    problem: AbstractLeastSquares, start: Float[np.ndarray, " variable"], solver: ProjectedLevenbergMarquardt
) -> str:
    """Name a solve by its problem (every number in it, and its structure), start, solver, and our code."""
    problem = jax.tree.map(np.asarray, problem)
    # Functions by their names: what they are made of is numbers as well.
    structure = eqx.tree_pformat(problem)
    return content_hash(code_hash(), structure, *jax.tree.leaves(problem), np.asarray(start), repr(solver))
