"""Evidence for errors that no effect explains."""

import numpy as np
import pytest

from wrapjax.diagnosis.null_covariance import structured_evidence


def test_larger_unexplained_errors_are_evidence_where_the_smallest_do_not_suffice():
    assert structured_evidence(np.array([0.0, -30.0, -30.0])) == pytest.approx(0.0, abs=1e-9)
    assert structured_evidence(np.array([0.0, 3.0, -30.0])) == pytest.approx(np.log(1.0 + np.exp(3.0)))
    # A common factor of all nulls changes nothing.
    assert structured_evidence(np.array([1000.0, 1003.0])) == pytest.approx(np.log(1.0 + np.exp(3.0)))
