"""Linearised fits of calibrated parameters, nuisances and further signatures to residuals.

The posterior mean of all parameters, with unit priors, under the covariance of what is independent between
cycles: noise, and errors of EMG and angles. Fits to all but some cycles predict the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.null_hypotheses.error_sources import input_blocks

#: Signatures of one prior standard deviation of each parameter, N m.
ScaledSignatures = Float[np.ndarray, "parameter cycle coordinate phase"]


@dataclass(frozen=True)
class ResidualModel:
    """Signatures of everything that is free in a null hypothesis, and residuals, by cycle and whitened.

    Parameters
    ----------
    roots
        Cholesky factor of the covariance within each cycle, N m.
    columns
        Whitened signatures of one prior standard deviation.
    """

    roots: Float[np.ndarray, "cycle own own"]
    columns: Float[np.ndarray, "cycle own parameter"]
    shape: tuple[int, int, int]

    @classmethod
    def of(cls, linearized: LinearizedModel) -> ResidualModel:
        """Build the model from the calibrated parameters and nuisances of a linearised model."""
        cycles, coordinates, phases = linearized.residual.shape
        block = linearized.noise.block(phases)
        blocks = np.repeat(block[None], cycles, axis=0)
        for share, errors in zip(linearized.noise.input_shares, linearized.input_errors, strict=True):
            blocks = blocks + share**2 * input_blocks(errors)
        roots = np.linalg.cholesky(blocks)
        free = np.concatenate([linearized.calibrated, linearized.nuisances])
        model = cls(roots, np.zeros((cycles, coordinates * phases, 0)), (cycles, coordinates, phases))
        return model.adding(free)

    def adding(self, signatures: ScaledSignatures) -> ResidualModel:
        """Add signatures of one prior standard deviation of further parameters."""
        return ResidualModel(
            self.roots, np.concatenate([self.columns, self.whitened(signatures)], axis=2), self.shape
        )

    def whitened(
        self, values: Float[np.ndarray, "any cycle coordinate phase"]
    ) -> Float[np.ndarray, "cycle own any"]:
        """Multiply by the inverse of the root of the covariance of each cycle."""
        cycles, coordinates, phases = self.shape
        rows = np.moveaxis(values.reshape(len(values), cycles, coordinates * phases), 0, 2)
        return np.stack(
            [
                scipy.linalg.solve_triangular(root, own, lower=True, check_finite=False)
                for root, own in zip(self.roots, rows, strict=True)
            ]
        )

    def fit(
        self, residuals: Float[np.ndarray, "sample cycle coordinate phase"]
    ) -> Float[np.ndarray, "sample cycle coordinate phase"]:
        """Subtract what all parameters, fitted to all cycles, predict; N m.

        Parameters
        ----------
        residuals
            Residuals at the prior mean of the parameters, N m.
        """
        white = self.whitened(residuals)
        rows = _rows(self.columns)
        mean = np.linalg.solve(rows.T @ rows + np.eye(rows.shape[1]), rows.T @ _rows(white))
        left = white - self.columns @ mean
        return np.moveaxis(self.roots @ left, 2, 0).reshape(len(residuals), *self.shape)


@dataclass(frozen=True)
class UnseenCycles:
    """Error of cycles that were left out of a linearised fit, without further parameters and with some.

    Parameters
    ----------
    columns, residual
        Whitened signatures of the parameters that are always fitted, and the whitened residual.
    blocks
        Cycles of each block that is left out.
    """

    columns: Float[np.ndarray, "cycle own parameter"]
    residual: Float[np.ndarray, "cycle own"]
    blocks: Sequence[Int[np.ndarray, " _"]]

    def errors(self, further: Sequence[Float[np.ndarray, "cycle own _"]]) -> Float[np.ndarray, " set"]:
        """Compute the mean squared error of unseen cycles, in noise variances, with sets of further columns.

        Parameters
        ----------
        further
            Whitened signatures of one prior standard deviation, by set; a set may be empty.
        """
        total, count = np.zeros(len(further)), 0
        for block in self.blocks:
            seen = np.setdiff1d(np.arange(len(self.residual)), block)
            base, target = _rows(self.columns[seen]), self.residual[seen].ravel()
            factor = scipy.linalg.cho_factor(base.T @ base + np.eye(base.shape[1]), check_finite=False)
            alone = scipy.linalg.cho_solve(factor, base.T @ target, check_finite=False)
            unseen_base, unseen = _rows(self.columns[block]), self.residual[block].ravel()
            for place, columns in enumerate(further):
                own = _rows(columns[seen])
                across = base.T @ own
                moved = scipy.linalg.cho_solve(factor, across, check_finite=False)
                marginal = own.T @ own - across.T @ moved + np.eye(own.shape[1])
                sizes = np.linalg.solve(marginal, own.T @ target - across.T @ alone)
                left = unseen - unseen_base @ (alone - moved @ sizes) - _rows(columns[block]) @ sizes
                total[place] += left @ left
            count += unseen.size
        return total / count


def _rows(values: Float[np.ndarray, "cycle own any"]) -> Float[np.ndarray, "row any"]:
    return values.reshape(values.shape[0] * values.shape[1], values.shape[2])


def repeatable_rms(
    residuals: Float[np.ndarray, "sample cycle coordinate phase"], speeds: Int[np.ndarray, " cycle"]
) -> Float[np.ndarray, " sample"]:
    """Compute the root mean square of the mean residual over the cycles of each speed, N m."""
    means = [residuals[:, speeds == speed].mean(axis=1) for speed in np.unique(speeds)]
    return np.asarray(np.sqrt(np.mean(np.stack(means) ** 2, axis=(0, 2, 3))))
