"""Loss of evidence for a known cause, from the simulator's signal to the residual of the calibrated model.

``python -m validation.diagnosis.signal_losses --bank BANK --lines LINES`` reads the linearized models of a
development bank (see `validation.diagnosis.linearizations`) and, from the bank's library, the true signal of
each single cause, and prints in standard deviations:

- ``d*``: detectability by the simulator, with its own curves and parameters; - ``seen``: size of the signal
under the most probable null hypothesis; - ``captured``: share of its square that the signatures of the effect
can form; the rest has a shape that is not in
  the catalogue;
- ``found``: projection of the residual on the signal. In the linearized model it equals ``seen`` within about
1; a
  smaller value means that the calibration compensated for more than the linearized model predicts.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
from jaxtyping import Float

from validation.blind.effects import EFFECTS
from validation.blind.library import SHARE, library_of
from validation.diagnosis.bank_cases import CLEAR
from validation.diagnosis.linearizations import (
    LinearizedCase,
    development_linearizations,
    linearizations_parser,
)
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.evidence.score_test import project
from wrapjax.diagnosis.null_hypotheses.error_sources import Matrix
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls
from wrapjax.errors import InputError

_RANK = 1e-8


@dataclass(frozen=True)
class SignalLoss:
    """Sizes of the signal of a cause at each step; see the module."""

    d_star: float
    seen: float
    captured: float
    found: float


def main() -> int:
    options = linearizations_parser("signal_losses", __doc__).parse_args()
    found: dict[str, list[SignalLoss]] = {}
    try:
        for truth, lines in development_linearizations(options.bank, options.lines):
            if truth["tier"] == "single" and truth["d_star"] > CLEAR:
                cause = truth["causes"][0]["id"]
                signal = signal_of(options.bank, truth)
                one = signal_loss(lines, signal, cause, truth["d_star"])
                found.setdefault(cause, []).append(one)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{'':36s}{'cases':>6s}{'d*':>8s}{'seen':>8s}{'captured':>10s}{'found':>8s}")
    rows = {
        id: [np.median(column) for column in zip(*map(astuple, own), strict=True)]
        for id, own in found.items()
    }
    for id in sorted(rows, key=lambda id: -rows[id][1] * np.sqrt(rows[id][2])):
        print(_row(id, len(found[id]), rows[id]))
    every = [astuple(one) for own in found.values() for one in own]
    print(
        _row("medians of all cases", len(every), [np.median(column) for column in zip(*every, strict=True)])
    )
    return 0


def signal_of(bank: Path, truth: Mapping[str, Any]) -> Float[np.ndarray, "cycle phase coordinate"]:
    """Read a cause's signal over the calibration cycles, N m, scaled from the library by the amount."""
    cause = truth["causes"][0]
    library = library_of(bank, truth["person"])
    place = library.entries.index((cause["id"], tuple(cause["variant"])))
    share = cause["amount"] / (SHARE * EFFECTS[cause["id"]].most)
    return share * library.signals[:, place]


def signal_loss(
    lines: LinearizedCase,
    signal: Float[np.ndarray, "cycle phase coordinate"],
    cause: str,
    d_star: float,
) -> SignalLoss:
    """Compute the sizes of a signal under the null hypothesis, in the signatures and in the residual."""
    linearized = lines.linearized
    own = linearized.residual.reshape(1, -1)
    null = max(
        nulls(linearized, lines.recorded.measured_moment_sd), key=lambda one: project(own, one, ()).weight[0]
    )
    factor = scipy.linalg.cholesky(null.covariance, lower=True)
    left, residual = standardize(np.stack([in_residual_order(signal, linearized), own[0]]), factor).T
    seen = float(np.linalg.norm(left))
    candidate = next(one for one in linearized.candidates if one.id == cause)
    return SignalLoss(d_star, seen, captured_share(left, candidate, factor), float(left @ residual) / seen)


def in_residual_order(
    signal: Float[np.ndarray, "..."], linearized: LinearizedModel
) -> Float[np.ndarray, " row"]:
    """Reorder a signal of the simulator (cycle, phase, coordinate) as residuals are."""
    cycles, coordinates, phases = linearized.residual.shape
    return np.reshape(signal, (cycles, phases, coordinates)).transpose(0, 2, 1).ravel()


def standardize(rows: Float[np.ndarray, "_ row"], factor: Matrix) -> Float[np.ndarray, "row _"]:
    """Divide rows by the Cholesky factor of the covariance of a null hypothesis."""
    return np.asarray(scipy.linalg.solve_triangular(factor, rows.T, lower=True))


def captured_share(left: Float[np.ndarray, " row"], candidate: Candidate, factor: Matrix) -> float:
    """Compute the share of a squared standardized signal that the best variant of an effect can form."""
    captured = 0.0
    for variant in candidate.variants:
        basis, sizes, _ = np.linalg.svd(standardize(variant, factor), full_matrices=False)
        basis = basis[:, sizes > _RANK * sizes.max(initial=0.0)]
        captured = max(captured, float(np.sum((basis.T @ left) ** 2) / np.sum(left**2)))
    return captured


def _row(label: str, cases: int, values: list[Any]) -> str:
    d_star, seen, captured, found = values
    return f"{label:36s}{cases:6d}{d_star:8.1f}{seen:8.1f}{captured:10.2f}{found:8.1f}"


if __name__ == "__main__":
    sys.exit(main())
