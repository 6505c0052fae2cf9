"""Synthetic linearized cases."""

import numpy as np

from validation.diagnosis.linearizations import LinearizedCase
from wrapjax.diagnosis.claims.gates import Recorded
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.null_hypotheses.error_sources import MuscleErrors

CYCLES, COORDINATES, PHASES = 4, 2, 25
SHAPE = (CYCLES, COORDINATES, PHASES)


def lines(signal, signatures, *, calibrated=None):
    """Linearize a synthetic case: residual of signal and noise, and effects with given signatures.

    Axes of signals are cycle, phase and coordinate, as in the simulator.
    """
    generator = np.random.default_rng(1)
    rows = signal.transpose(0, 2, 1)
    linearized = LinearizedModel(
        residual=rows + generator.normal(size=SHAPE),
        fitted_residual=generator.normal(size=SHAPE),
        slopes=np.zeros((1, *SHAPE)) if calibrated is None else calibrated.transpose(0, 2, 1)[None],
        prior_root=np.array([[100.0]]),
        from_prior_mean=np.zeros(1),
        nuisances=np.zeros((1, *SHAPE)),
        candidates=tuple(
            Candidate(id, (signature.transpose(0, 2, 1).reshape(1, -1),), np.ones(1), np.zeros(1, bool))
            for id, signature in signatures.items()
        ),
        input_errors=(),
        muscle_errors=MuscleErrors(np.zeros((1, CYCLES, PHASES, 3)), np.zeros((1, *SHAPE))),
        speeds=np.zeros(CYCLES, dtype=int),
    )
    still = np.zeros(SHAPE)
    recorded = Recorded(still, still, (np.array([0, 1]), np.array([2, 3])), np.full(COORDINATES, 1e-3))
    return LinearizedCase(linearized, recorded, generator.normal(size=(3, rows.size)))
