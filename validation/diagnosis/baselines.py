"""What textbooks would do in place of a diagnosis: three ways of ranking effects, on the same straight lines.

They see what the score of `wrapjax.diagnosis` sees and answer in the same files: one scorer judges all.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
from jaxtyping import Float
from scipy.special import softmax
from scipy.stats import chi2

from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.io.files import write_json

Rows = Float[np.ndarray, "column row"]

#: Family-wise level of the modification index, shared by all effects (Bonferroni).
LEVEL = 0.05
#: Blocks of cycles that are left out in turn.
BLOCKS = 5


def raw_correlation(gap: LinearizedModel) -> dict[str, tuple[float, bool]]:
    """Correlate each effect's signatures with the residual; it has no threshold, so that all are named.

    Returns
    -------
    By id, the multiple correlation of the best shape, and whether it would be named.
    """
    residual = gap.fitted.ravel()
    length = np.linalg.norm(residual)

    def of(signature: Rows) -> float:
        basis = scipy.linalg.orth(signature.T)
        return float(np.linalg.norm(basis.T @ residual) / length)

    return {one.id: (max(map(of, one.variants)), True) for one in gap.candidates}


def modification_index(gap: LinearizedModel) -> dict[str, tuple[float, bool]]:
    """Test effects as structural equation models do: independent noise, what is calibrated projected out.

    Returns
    -------
    By id, less the logarithm of its p-value, and whether that passes Bonferroni's level.
    """
    residual = gap.fitted.ravel()
    calibrated = scipy.linalg.orth(gap.slopes.reshape(len(gap.slopes), -1).T)

    def without(columns: np.ndarray) -> np.ndarray:
        return np.asarray(columns - calibrated @ (calibrated.T @ columns))

    left = without(residual)
    variance = left @ left / (left.size - calibrated.shape[1])
    limit = -np.log(LEVEL / len(gap.candidates))

    def of(signature: Rows) -> float:
        basis = scipy.linalg.orth(without(signature.T))
        index = float(np.sum((basis.T @ left) ** 2) / variance)
        return -float(chi2.logsf(index, basis.shape[1]))

    found = {one.id: max(map(of, one.variants)) for one in gap.candidates}
    return {id: (value, value > limit) for id, value in found.items()}


def held_out_drop(gap: LinearizedModel) -> dict[str, tuple[float, bool]]:
    """Refit each effect along straight lines, with all that is calibrated, to parts of the cycles.

    Returns
    -------
    By id, the share of the squared error of left-out cycles that it takes away, and whether that is any.
    """
    cycles = len(gap.residual)
    blocks = np.arange(cycles) % min(BLOCKS, cycles)
    residual = gap.residual.reshape(cycles, -1)
    calibrated = gap.calibrated.reshape(len(gap.spread.T), cycles, -1)
    variance = float(np.mean(gap.fitted**2))

    def error(columns: Float[np.ndarray, "column cycle own"]) -> float:
        """All columns are in prior standard deviations."""
        total = 0.0
        for block in range(blocks.max() + 1):
            seen, left_out = blocks != block, blocks == block
            known = columns[:, seen].reshape(len(columns), -1)
            weights = np.linalg.solve(
                known @ known.T + variance * np.eye(len(columns)), known @ residual[seen].ravel()
            )
            total += float(np.sum((residual[left_out] - np.tensordot(weights, columns[:, left_out], 1)) ** 2))
        return total

    before = error(calibrated)
    drops = {
        one.id: max(
            1.0 - error(np.concatenate([calibrated, _in_deviations(shape, one.prior_sd, cycles)])) / before
            for shape in one.variants
        )
        for one in gap.candidates
    }
    return {id: (drop, drop > 0.0) for id, drop in drops.items()}


def _in_deviations(
    signature: Rows, prior_sd: Float[np.ndarray, " amount"], cycles: int
) -> Float[np.ndarray, "amount cycle own"]:
    return (signature * prior_sd[:, None]).reshape(len(signature), cycles, -1)


#: By the name under which it is scored.
BASELINES: dict[str, Callable[[LinearizedModel], dict[str, tuple[float, bool]]]] = {
    "modification_index": modification_index,
    "raw_correlation": raw_correlation,
    "held_out_drop": held_out_drop,
}


def write_answer(statistics: dict[str, tuple[float, bool]], folder: Path) -> None:
    """Write what a scorer reads of ``gap.json``: the first is named if it may be."""
    order = sorted(statistics, key=lambda id: -statistics[id][0])
    first = order[0]
    names = statistics[first][1]
    ranks = softmax(-np.arange(len(order), dtype=float))
    effects = [{"id": id, "probability": float(share)} for id, share in zip(order, ranks, strict=True)]
    _write(folder, "named" if names else "none", [first] if names else [], [first], effects)


def write_silence(outcome: str, folder: Path) -> None:
    """Write that there was nothing to rank."""
    _write(folder, outcome, [], [], [])


def _write(
    folder: Path, outcome: str, named: list[str], credible: list[str], effects: list[dict[str, Any]]
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    answer = {"outcome": outcome, "named": named, "ties": [], "credible_set": credible, "effects": effects}
    write_json(folder / "gap.json", answer)
