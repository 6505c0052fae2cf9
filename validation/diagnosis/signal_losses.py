"""Where evidence for a known cause is lost, from the simulator's signal to a diagnosis's signatures.

``python -m validation.diagnosis.signal_losses --bank BANK --lines LINES`` takes a development bank and its straight lines (see
`validation.diagnosis.linearizations`) and follows the true signal of each single cause, which the bank's library holds, all in
standard deviations:

- ``d*``, what the simulator could see of it, knowing its own curves and parameters;
- ``seen``, what the null hypothesis that the residual speaks for leaves of it;
- ``captured``, what share of that (of its square) the effect's own signatures can form: the rest is of a
  shape that the catalogue does not have;
- ``found``, how much of it the calibrated model's residual holds. Along straight lines it is as much as is
  seen, give or take 1. Where it is less, calibration took up what straight lines say it cannot.
"""

from __future__ import annotations

import argparse
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
from validation.diagnosis.linearizations import Lines, development_lines
from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null import nulls
from wrapjax.diagnosis.null_covariance import Matrix
from wrapjax.diagnosis.projection import Candidate, project
from wrapjax.errors import InputError

_RANK = 1e-8


@dataclass(frozen=True)
class Loss:
    """A cause's signal on its way; see the module."""

    d_star: float
    seen: float
    captured: float
    found: float


def main() -> int:
    options = _parser().parse_args()
    found: dict[str, list[Loss]] = {}
    try:
        for truth, lines in development_lines(options.bank, options.lines):
            if truth["tier"] == "single" and truth["d_star"] > CLEAR:
                cause = truth["causes"][0]["id"]
                signal = signal_of(options.bank, truth)
                one = loss(lines, signal, cause, truth["d_star"])
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
        _row("all of them, medians", len(every), [np.median(column) for column in zip(*every, strict=True)])
    )
    return 0


def signal_of(bank: Path, truth: Mapping[str, Any]) -> Float[np.ndarray, "cycle phase coordinate"]:
    """Read a cause's signal over the calibration cycles, N m: the library's, in proportion to the amount."""
    cause = truth["causes"][0]
    library = library_of(bank, truth["person"])
    place = library.entries.index((cause["id"], tuple(cause["variant"])))
    share = cause["amount"] / (SHARE * EFFECTS[cause["id"]].most)
    return share * library.signals[:, place]


def loss(
    lines: Lines,
    signal: Float[np.ndarray, "cycle phase coordinate"],
    cause: str,
    d_star: float,
) -> Loss:
    """Follow a signal through the null hypothesis, the effect's signatures and the residual."""
    gap = lines.gap
    own = gap.residual.reshape(1, -1)
    null = max(nulls(gap, lines.sizes), key=lambda one: project(own, one, ()).weight[0])
    factor = scipy.linalg.cholesky(null.covariance, lower=True)
    left, residual = white(np.stack([in_rows(signal, gap), own[0]]), factor).T
    seen = float(np.linalg.norm(left))
    candidate = next(one for one in gap.candidates if one.id == cause)
    return Loss(d_star, seen, captured_share(left, candidate, factor), float(left @ residual) / seen)


def in_rows(signal: Float[np.ndarray, "..."], gap: LinearizedModel) -> Float[np.ndarray, " row"]:
    """Put a signal of the simulator (cycle, phase, coordinate) in the order of residuals."""
    cycles, coordinates, phases = gap.residual.shape
    return np.reshape(signal, (cycles, phases, coordinates)).transpose(0, 2, 1).ravel()


def white(rows: Float[np.ndarray, "_ row"], factor: Matrix) -> Float[np.ndarray, "row _"]:
    """Give rows in standard deviations of a null hypothesis, by the factor of its covariance."""
    return np.asarray(scipy.linalg.solve_triangular(factor, rows.T, lower=True))


def captured_share(left: Float[np.ndarray, " row"], candidate: Candidate, factor: Matrix) -> float:
    """Say what share of what is left of a signal (of its square) an effect's best shape can form."""
    captured = 0.0
    for variant in candidate.variants:
        basis, sizes, _ = np.linalg.svd(white(variant, factor), full_matrices=False)
        basis = basis[:, sizes > _RANK * sizes.max(initial=0.0)]
        captured = max(captured, float(np.sum((basis.T @ left) ** 2) / np.sum(left**2)))
    return captured


def _row(label: str, cases: int, values: list[Any]) -> str:
    d_star, seen, captured, found = values
    return f"{label:36s}{cases:6d}{d_star:8.1f}{seen:8.1f}{captured:10.2f}{found:8.1f}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.diagnosis.signal_losses", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--lines", type=Path, required=True)
    return parser


if __name__ == "__main__":
    sys.exit(main())
