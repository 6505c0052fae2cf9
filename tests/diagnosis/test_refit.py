"""Which effects are refitted: the strongest, and others only where their evidence is not that of noise."""

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import SHAPE, lines
from wrapjax.diagnosis.evidence.score import Scores, score
from wrapjax.diagnosis.fits.refit import REFITTED, effects_to_refit


@pytest.fixture(scope="module")
def scores():
    cycles, coordinates, phases = SHAPE
    shape = (cycles, phases, coordinates)
    signatures = {"cop_offset": np.ones(shape)}
    case = lines(np.zeros(shape), signatures)
    found = score(case.linearized, case.recorded.measured_moment_sd, case.null_residuals, 0.0)
    return replace(found, detection_threshold=5.0)


@pytest.mark.parametrize(
    ("evidence", "refitted"),
    [
        ((9.0, 6.0, 5.5), REFITTED),
        ((9.0, 4.0), 1),
        ((1.0, 0.5), 1),
        ((-0.1, -0.5), 0),
        ((), 0),
    ],
)
def test_the_strongest_effect_is_refitted_and_others_if_significant(scores, monkeypatch, evidence, refitted):
    known = {f"effect_{number}": nats for number, nats in enumerate(evidence)}
    monkeypatch.setattr(Scores, "evidence", property(lambda _: known))
    assert effects_to_refit(scores) == tuple((id,) for id in list(known)[:refitted])
