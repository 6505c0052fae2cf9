"""Evidence for an unknown cause is that for a large repeatable error."""

import numpy as np
import pytest

from wrapjax.diagnosis.null_covariance import FORCE_ERRORS, REPEATABLE_ERRORS, structured_evidence


def weights(**by_error):
    """Log posterior probabilities of all nulls, by the size of their repeatable error."""
    rows = np.full((len(FORCE_ERRORS), len(REPEATABLE_ERRORS)), -50.0)
    for name, weight in by_error.items():
        rows[:, ("none", "small", "large").index(name)] = weight
    return rows.ravel()


def test_only_a_large_repeatable_error_is_evidence_for_an_unknown_cause():
    assert len(REPEATABLE_ERRORS) == 3 and REPEATABLE_ERRORS[-1] == max(REPEATABLE_ERRORS)
    assert structured_evidence(weights(none=0.0)) < -40.0
    assert structured_evidence(weights(small=30.0)) < -70.0
    assert structured_evidence(weights(small=5.0, large=8.0)) == pytest.approx(3.0)
    # One null of few with small errors is enough against it.
    rows = weights(large=3.0).reshape(len(FORCE_ERRORS), -1)
    rows[2, 0] = 9.0
    assert structured_evidence(rows.ravel()) == pytest.approx(3.0 + np.log(4.0) - 9.0, abs=1e-9)


def test_a_common_factor_of_all_nulls_changes_nothing():
    own = weights(small=1.0, large=2.0)
    assert structured_evidence(own + 1000.0) == pytest.approx(structured_evidence(own))
