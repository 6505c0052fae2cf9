"""Straight lines that were kept are those that were drawn."""

import json

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import SHAPE, lines
from validation.diagnosis.linearizations import Lines, development_lines, load, save
from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null_covariance import InputErrors, MuscleErrors
from wrapjax.diagnosis.projection import Candidate
from wrapjax.errors import InputError


def test_lines_come_back(tmp_path):
    draw = np.random.default_rng(3).normal
    rows = (4, 2, 5)
    gap = LinearizedModel(
        residual=draw(size=rows),
        fitted=draw(size=rows),
        slopes=draw(size=(3, *rows)),
        spread=draw(size=(3, 3)),
        away=draw(size=3),
        nuisances=draw(size=(2, *rows)),
        candidates=(
            Candidate("one", (draw(size=(2, 40)), draw(size=(2, 40))), np.ones(2), np.array([True, False])),
            Candidate("other", (draw(size=(3, 40)),), np.ones(3), np.zeros(3, bool), ((0,), (1, 2)), 4.0),
        ),
        input_errors=(InputErrors(draw(size=(2, *rows)), 0.04), InputErrors(draw(size=(1, *rows)), 0.08)),
        muscle_errors=MuscleErrors(draw(size=(2, 4, 5, 3)), draw(size=(2, *rows))),
        speeds=np.array([0, 0, 1, 1]),
    )
    save(Lines(gap, np.ones(2)), tmp_path / "case.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["case.npz"]
    found = load(tmp_path / "case.npz").gap
    for name in ("residual", "fitted", "slopes", "spread", "away", "nuisances", "speeds"):
        np.testing.assert_allclose(getattr(found, name), getattr(gap, name), rtol=1e-6, err_msg=name)
    for one, other in zip(found.candidates, gap.candidates, strict=True):
        assert (one.id, one.parts) == (other.id, other.parts)
        np.testing.assert_array_equal(one.one_sided, other.one_sided)
        np.testing.assert_array_equal(one.limit, np.full(len(one.prior_sd), other.limit))
        np.testing.assert_allclose(one.variants, other.variants, rtol=1e-6)
    assert [errors.width for errors in found.input_errors] == pytest.approx([0.04, 0.08], rel=1e-6)
    np.testing.assert_allclose(found.muscle_errors.states, gap.muscle_errors.states, rtol=1e-6)


def test_lines_of_another_version_are_refused_in_a_sentence(tmp_path):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "a.json").write_text(json.dumps({"bank": "development"}))
    file = tmp_path / "lines" / "a.npz"
    save(
        lines(np.zeros((SHAPE[0], SHAPE[2], SHAPE[1])), {"one": np.ones((SHAPE[0], SHAPE[2], SHAPE[1]))}),
        file,
    )
    with np.load(file) as whole:
        earlier = {name: own for name, own in whole.items() if name != "limit_0"}
    np.savez(file, **earlier)
    with pytest.raises(InputError, match=r"lines without 'limit_0'; .*draw them anew"):
        list(development_lines(tmp_path, tmp_path / "lines"))
