"""Displaced cylinders are recovered where moments identify moment arms."""

import pytest

from tests.path_sources.hidden_cylinders import errors_of_identifiable_arms, hidden
from wrapjax.calibration.problem import build_objective
from wrapjax.datasets.virtual_person.true_parameters import parameter_names
from wrapjax.datasets.virtual_person.virtual_subject import Series, write_virtual_subject
from wrapjax.path_sources.exact import exact_geometry
from wrapjax.subject.subject import load_subject


@pytest.mark.slow
def test_cylinders_are_recovered_with_all_parameters_unknown(tmp_path):
    """Twenty people, with all parameters of muscles and all cylinders unknown."""
    falls = []
    for seed in range(20):
        folder = tmp_path / str(seed)
        series = (Series(0.8, 1, 0), Series(1.2, 1, 0))
        truth = write_virtual_subject(
            folder, seed=seed, emg_noise=0.0, moment_noise=0.0, series=series, wrap_spread=0.6
        )
        subject = load_subject(folder)
        geometry = exact_geometry(subject)
        wraps = geometry.freedom("PGA", subject).wraps
        values = {name: getattr(truth, name) for name in parameter_names()}
        problem = build_objective(subject, "PGA", geometry)
        before, after = errors_of_identifiable_arms(*hidden(problem, wraps, truth.wraps, **values))
        assert before.size, f"subject {seed}: nothing can be told apart"
        falls.append(1.0 - after.mean() / before.mean())
        print(f"subject {seed}: {before.size} arms, errors fall by {falls[-1]:.3f}", flush=True)
    assert min(falls) >= 0.6
