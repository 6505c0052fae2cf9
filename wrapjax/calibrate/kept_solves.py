"""Solves that are kept: whatever stops work that needs many, at most the one under way is lost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from wrapjax.calibrate.problem import AbstractLeastSquares
from wrapjax.calibrate.projected_lm import ProjectedLM
from wrapjax.calibrate.solution import Status
from wrapjax.files import code_hash, content_hash, write_whole
from wrapjax.stored import load_arrays


@dataclass(frozen=True)
class KeptSolves:
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
        write_whole(
            self.folder / f"{name}.npz",
            lambda path: np.savez(path, variables=variables, status=np.array(status.name)),
        )


def name_of_solve(
    problem: AbstractLeastSquares, start: Float[np.ndarray, " variable"], solver: ProjectedLM
) -> str:
    """Name a solve by its problem (every number in it, and its structure), start, solver, and our code."""
    problem = jax.tree.map(np.asarray, problem)
    # Functions by their names: what they are made of is numbers as well.
    structure = eqx.tree_pformat(problem)
    return content_hash(code_hash(), structure, *jax.tree.leaves(problem), np.asarray(start), repr(solver))
