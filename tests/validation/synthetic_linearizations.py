"""Straight lines of a case that nobody recorded."""

import numpy as np

from validation.diagnosis.linearizations import Lines
from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null_covariance import MuscleErrors
from wrapjax.diagnosis.projection import Candidate

CYCLES, COORDINATES, PHASES = 4, 2, 25
SHAPE = (CYCLES, COORDINATES, PHASES)


def lines(signal, signatures, *, calibrated=None):
    """Lines of a residual of a signal beside noise, with effects that have these signatures.

    Signals lead with cycle, phase and coordinate, as the simulator's do.
    """
    generator = np.random.default_rng(1)
    rows = signal.transpose(0, 2, 1)
    gap = LinearizedModel(
        residual=rows + generator.normal(size=SHAPE),
        fitted=generator.normal(size=SHAPE),
        slopes=np.zeros((1, *SHAPE)) if calibrated is None else calibrated.transpose(0, 2, 1)[None],
        spread=np.array([[100.0]]),
        away=np.zeros(1),
        nuisances=np.zeros((1, *SHAPE)),
        candidates=tuple(
            Candidate(id, (own.transpose(0, 2, 1).reshape(1, -1),), np.ones(1), np.zeros(1, bool))
            for id, own in signatures.items()
        ),
        input_errors=(),
        muscle_errors=MuscleErrors(np.zeros((1, CYCLES, PHASES, 3)), np.zeros((1, *SHAPE))),
        speeds=np.zeros(CYCLES, dtype=int),
    )
    return Lines(gap, np.full(COORDINATES, 1e-3))
