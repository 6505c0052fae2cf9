"""Three standard statistics that rank effects, on the same linearized models as the score test.

They use the same data as the score of `wrapjax.diagnosis` and write answers in the same format, so that one
scorer evaluates all.
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

from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.io.files import write_json

Rows = Float[np.ndarray, "column row"]

#: Family-wise error rate of the modification index over all effects (Bonferroni).
LEVEL = 0.05
#: Number of blocks of cycles that are held out in turn.
BLOCKS = 5


def raw_correlation(linearized: LinearizedModel) -> dict[str, tuple[float, bool]]:
    """Correlate the signatures of each effect with the residual; there is no threshold.

    Returns
    -------
    dict
        Multiple correlation of the best variant of each effect, and True.
    """
    residual = linearized.fitted_residual.ravel()
    length = np.linalg.norm(residual)

    def of(signature: Rows) -> float:
        basis = scipy.linalg.orth(signature.T)
        return float(np.linalg.norm(basis.T @ residual) / length)

    return {one.id: (max(map(of, one.variants)), True) for one in linearized.candidates}


def modification_index(linearized: LinearizedModel) -> dict[str, tuple[float, bool]]:
    """Test effects by the modification index of structural equation models.

    Noise is independent, and the derivatives by calibrated variables are projected out.

    Returns
    -------
    dict
        Negative logarithm of the p-value of each effect, and whether it passes the Bonferroni level.
    """
    residual = linearized.fitted_residual.ravel()
    calibrated = scipy.linalg.orth(linearized.slopes.reshape(len(linearized.slopes), -1).T)

    def without(columns: np.ndarray) -> np.ndarray:
        return np.asarray(columns - calibrated @ (calibrated.T @ columns))

    left = without(residual)
    variance = left @ left / (left.size - calibrated.shape[1])
    limit = -np.log(LEVEL / len(linearized.candidates))

    def of(signature: Rows) -> float:
        basis = scipy.linalg.orth(without(signature.T))
        index = float(np.sum((basis.T @ left) ** 2) / variance)
        return -float(chi2.logsf(index, basis.shape[1]))

    found = {one.id: max(map(of, one.variants)) for one in linearized.candidates}
    return {id: (value, value > limit) for id, value in found.items()}


def held_out_drop(linearized: LinearizedModel) -> dict[str, tuple[float, bool]]:
    """Refit each effect with all calibrated variables in the linearized model, and predict held-out cycles.

    Returns
    -------
    dict
        Share of the squared error of held-out cycles that each effect removes, and whether it is positive.
    """
    cycles = len(linearized.residual)
    blocks = np.arange(cycles) % min(BLOCKS, cycles)
    residual = linearized.residual.reshape(cycles, -1)
    calibrated = linearized.calibrated.reshape(len(linearized.prior_root.T), cycles, -1)
    variance = float(np.mean(linearized.fitted_residual**2))

    def error(columns: Float[np.ndarray, "column cycle own"]) -> float:
        """Compute the held-out squared error; columns are per prior standard deviation."""
        total = 0.0
        for block in range(blocks.max() + 1):
            fitted, left_out = blocks != block, blocks == block
            known = columns[:, fitted].reshape(len(columns), -1)
            weights = np.linalg.solve(
                known @ known.T + variance * np.eye(len(columns)), known @ residual[fitted].ravel()
            )
            total += float(np.sum((residual[left_out] - np.tensordot(weights, columns[:, left_out], 1)) ** 2))
        return total

    before = error(calibrated)
    drops = {
        one.id: max(
            1.0 - error(np.concatenate([calibrated, _in_deviations(shape, one.prior_sd, cycles)])) / before
            for shape in one.variants
        )
        for one in linearized.candidates
    }
    return {id: (drop, drop > 0.0) for id, drop in drops.items()}


def _in_deviations(
    signature: Rows, prior_sd: Float[np.ndarray, " amount"], cycles: int
) -> Float[np.ndarray, "amount cycle own"]:
    return (signature * prior_sd[:, None]).reshape(len(signature), cycles, -1)


#: Baselines by the name of the answerer.
BASELINES: dict[str, Callable[[LinearizedModel], dict[str, tuple[float, bool]]]] = {
    "modification_index": modification_index,
    "raw_correlation": raw_correlation,
    "held_out_drop": held_out_drop,
}


def write_answer(statistics: dict[str, tuple[float, bool]], folder: Path) -> None:
    """Write the parts of ``gap.json`` that the scorer reads; the first effect is named if it may be."""
    order = sorted(statistics, key=lambda id: -statistics[id][0])
    first = order[0]
    names = statistics[first][1]
    ranks = softmax(-np.arange(len(order), dtype=float))
    effects = [{"id": id, "probability": float(share)} for id, share in zip(order, ranks, strict=True)]
    _write(folder, "named" if names else "none", [first] if names else [], [first], effects)


def write_no_answer(outcome: str, folder: Path) -> None:
    """Write an answer without effects."""
    _write(folder, outcome, [], [], [])


def _write(
    folder: Path, outcome: str, named: list[str], credible: list[str], effects: list[dict[str, Any]]
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    answer = {"outcome": outcome, "named": named, "ties": [], "credible_set": credible, "effects": effects}
    write_json(folder / "gap.json", answer)
