"""What an interrupted calibration leaves behind, to go on from."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from wrapjax.calibrate.augmented_lagrangian import LagrangianState
from wrapjax.calibrate.solution import Iteration, Pace, Status
from wrapjax.errors import InputError, Problem
from wrapjax.files import new_folder, write_json, write_whole
from wrapjax.stored import load_arrays, load_json


@dataclass(frozen=True)
class Entry:
    """Where one stage of one start stands."""

    state: LagrangianState
    history: tuple[Iteration, ...]
    #: None while it is under way.
    status: Status | None


@dataclass(frozen=True)
class Journal:
    """A folder with one file for each stage of each start.

    Every file is replaced whole after each iteration, so that whatever stops the process, what is
    there can be read and at most one step is lost.
    """

    folder: Path

    @classmethod
    def open(cls, folder: Path, question: str, *, resume: bool) -> Journal:
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
            "pace": np.array([state.pace.damping, state.pace.growth]),
            "gaps": np.array([state.gap, state.gap_before]),
            "history": np.array([astuple(iteration) for iteration in history], dtype=float),
            "status": np.array("" if status is None else status.name),
        }
        arrays |= {f"shift_{number}": shift for number, shift in enumerate(state.shifts)}
        arrays |= {f"weight_{number}": weight for number, weight in enumerate(state.weights)}
        plain: dict[str, Any] = {key: np.asarray(value) for key, value in arrays.items()}
        write_whole(self.folder / f"{name}.npz", lambda path: np.savez(path, **plain))

    def read(self, name: str) -> Entry | None:
        """Find where a stage stands; None if it was never begun, or what is there cannot be read."""
        try:
            kept = load_arrays(self.folder / f"{name}.npz")
            limits = sum(key.startswith("shift_") for key in kept)
            state = LagrangianState(
                variables=jnp.asarray(kept["variables"]),
                pace=Pace(*map(jnp.asarray, kept["pace"])),
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
