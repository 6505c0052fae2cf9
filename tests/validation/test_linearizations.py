"""Storage of linearized cases."""

import json

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import SHAPE, lines
from validation.diagnosis.linearizations import LinearizedCase, development_linearizations, load, save
from wrapjax.diagnosis.claims.gates import Recorded
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.null_hypotheses.error_sources import InputErrors, MuscleErrors
from wrapjax.errors import InputError


def test_linearized_case_is_read_as_written(tmp_path):
    draw = np.random.default_rng(3).normal
    rows = (4, 2, 5)
    linearized = LinearizedModel(
        residual=draw(size=rows),
        fitted_residual=draw(size=rows),
        slopes=draw(size=(3, *rows)),
        prior_root=draw(size=(3, 3)),
        from_prior_mean=draw(size=3),
        nuisances=draw(size=(2, *rows)),
        candidates=(
            Candidate("one", (draw(size=(2, 40)), draw(size=(2, 40))), np.ones(2), np.array([True, False])),
            Candidate("other", (draw(size=(3, 40)),), np.ones(3), np.zeros(3, bool), ((0,), (1, 2)), 4.0),
        ),
        input_errors=(InputErrors(draw(size=(2, *rows)), 0.04), InputErrors(draw(size=(1, *rows)), 0.08)),
        muscle_errors=MuscleErrors(draw(size=(2, 4, 5, 3)), draw(size=(2, *rows))),
        speeds=np.array([0, 0, 1, 1]),
    )
    replicates = draw(size=(3, 40))
    recorded = Recorded(draw(size=rows), draw(size=rows), (np.array([0]), np.array([1, 2, 3])), np.ones(2))
    save(LinearizedCase(linearized, recorded, replicates), tmp_path / "case.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["case.npz"]
    loaded = load(tmp_path / "case.npz").linearized
    np.testing.assert_allclose(load(tmp_path / "case.npz").null_residuals, replicates, rtol=1e-6)
    again = load(tmp_path / "case.npz").recorded
    np.testing.assert_allclose(again.angles, recorded.angles, rtol=1e-6)
    np.testing.assert_allclose(again.velocities, recorded.velocities, rtol=1e-6)
    np.testing.assert_array_equal(np.concatenate(again.blocks), np.arange(4))
    for name in (
        "residual",
        "fitted_residual",
        "slopes",
        "prior_root",
        "from_prior_mean",
        "nuisances",
        "speeds",
    ):
        np.testing.assert_allclose(getattr(loaded, name), getattr(linearized, name), rtol=1e-6, err_msg=name)
    for one, other in zip(loaded.candidates, linearized.candidates, strict=True):
        assert (one.id, one.parts) == (other.id, other.parts)
        np.testing.assert_array_equal(one.one_sided, other.one_sided)
        np.testing.assert_array_equal(one.limit, np.full(len(one.prior_sd), other.limit))
        np.testing.assert_allclose(one.variants, other.variants, rtol=1e-6)
    assert [errors.width for errors in loaded.input_errors] == pytest.approx([0.04, 0.08], rel=1e-6)
    np.testing.assert_allclose(loaded.muscle_errors.states, linearized.muscle_errors.states, rtol=1e-6)


def test_file_of_another_version_is_an_input_error(tmp_path):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "a.json").write_text(json.dumps({"bank": "development"}))
    file = tmp_path / "lines" / "a.npz"
    save(
        lines(np.zeros((SHAPE[0], SHAPE[2], SHAPE[1])), {"one": np.ones((SHAPE[0], SHAPE[2], SHAPE[1]))}),
        file,
    )
    with np.load(file) as arrays:
        earlier = {name: array for name, array in arrays.items() if name != "limit_0"}
    np.savez(file, **earlier)
    with pytest.raises(InputError, match=r"linearized case without 'limit_0'; .*linearize the cases again"):
        list(development_linearizations(tmp_path, tmp_path / "lines"))
