"""Moments find hidden cylinders where they can tell a moment arm from a muscle's gain."""

import pytest

from tests.api.hidden_cylinders import errors_of_told_arms, hidden
from wrapjax.api.calibrating.problem import prepare
from wrapjax.api.paths.exact import exact_geometry
from wrapjax.subject import read_subject
from wrapjax.virtual import Series, write_virtual_subject
from wrapjax.virtual.truth import parameter_names


@pytest.mark.slow
def test_cylinders_are_found_beside_everything(tmp_path):
    """Twenty people, with every parameter of their muscles and every cylinder hidden."""
    falls = []
    for seed in range(20):
        folder = tmp_path / str(seed)
        series = (Series(0.8, 1, 0), Series(1.2, 1, 0))
        truth = write_virtual_subject(
            folder, seed=seed, emg_noise=0.0, moment_noise=0.0, series=series, wrap_spread=0.6
        )
        subject = read_subject(folder)
        geometry = exact_geometry(subject)
        wraps = geometry.freedom("PGA", subject).wraps
        values = {name: getattr(truth, name) for name in parameter_names()}
        problem = prepare(subject, "PGA", geometry)
        before, after = errors_of_told_arms(*hidden(problem, wraps, truth.wraps, **values))
        assert before.size, f"subject {seed}: nothing can be told apart"
        falls.append(1.0 - after.mean() / before.mean())
        print(f"subject {seed}: {before.size} arms, errors fall by {falls[-1]:.3f}", flush=True)
    assert min(falls) >= 0.6
