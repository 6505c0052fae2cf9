"""The cache of joint fits: a finished fit is read bit for bit; an interrupted fit is not kept."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.diagnosis.joint_leg import WEIGHT, damped_leg
from wrapjax.calibration.solvers.checkpoints import solve_fingerprint
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.diagnosis.fits.joint_fit import SOLVER, fit_jointly, joint_problem
from wrapjax.io.store import Store


@pytest.fixture(scope="module")
def leg():
    """A problem and a start away from its minimum."""
    plain, effects, truth, effect_sizes = damped_leg()
    problem = joint_problem(plain, effects, truth, np.zeros(effects.count), WEIGHT)
    return problem, np.concatenate([truth, 0.5 * effect_sizes / effects.prior_sd])


@pytest.fixture(scope="module")
def done(leg, tmp_path_factory):
    """A cache and the fit in it."""
    kept = Store(tmp_path_factory.mktemp("kept"))
    return kept, fit_jointly(*leg, cache=kept)


def failing_steps(monkeypatch, wrong=KeyboardInterrupt):
    """Raise an exception at every step of the solver."""

    def step(*_):
        raise wrong

    monkeypatch.setattr(ProjectedLevenbergMarquardt, "_advance", step)


def test_a_cached_fit_is_not_solved_again(leg, done, monkeypatch):
    kept, first = done
    failing_steps(monkeypatch, AssertionError("solved again"))
    again = fit_jointly(*leg, cache=kept)
    assert again.status is first.status
    assert again.cost == first.cost
    np.testing.assert_array_equal(again.variables, first.variables)
    for one, other in zip(jax.tree.leaves(again.model), jax.tree.leaves(first.model), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_fingerprint_depends_on_everything_that_decides_a_fit(leg):
    problem, start = leg
    plain = problem.plain
    elsewhere = plain.recording.emg.coefficients.at[0, 0, 0, 0].add(1e-12)
    curves = replace(plain.curves, passive=plain.curves.passive + 1e-12)
    others = {
        "measured": replace(problem, plain=replace(plain, measured=plain.measured.at[0, 0, 0].add(1e-12))),
        "emg": replace(
            problem,
            plain=replace(
                plain,
                recording=replace(plain.recording, emg=replace(plain.recording.emg, coefficients=elsewhere)),
            ),
        ),
        "curves": replace(problem, plain=replace(plain, curves=curves)),
        "cycles": replace(problem, plain=replace(plain, moment_error=np.ones((4, 1, 1)))),
        "effects": replace(
            problem, alteration_functions=problem.alteration_functions[::-1], counts=problem.counts[::-1]
        ),
        "priors": replace(problem, effect_size_weight=2.0 * problem.effect_size_weight),
    }
    names = {solve_fingerprint(one, start, SOLVER) for one in others.values()}
    names |= {
        solve_fingerprint(problem, start, SOLVER),
        solve_fingerprint(problem, start + 1e-12, SOLVER),
        solve_fingerprint(problem, start, replace(SOLVER, ftol=1e-6)),
    }
    assert len(names) == len(others) + 3
    assert solve_fingerprint(jax.tree.map(np.asarray, problem), start, SOLVER) in names


@pytest.mark.parametrize("content", [b"", b"rubbish", None])
def test_a_damaged_file_is_solved_again(leg, done, tmp_path, content):
    kept, first = done
    (whole,) = kept.folder.iterdir()
    own = Store(tmp_path)
    (tmp_path / whole.name).write_bytes(whole.read_bytes()[:100] if content is None else content)
    np.testing.assert_array_equal(fit_jointly(*leg, cache=own).variables, first.variables)
    assert (tmp_path / whole.name).read_bytes() == whole.read_bytes()


def test_an_interrupted_fit_raises_and_is_not_cached(leg, monkeypatch, tmp_path):
    failing_steps(monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        fit_jointly(*leg, cache=Store(tmp_path))
    assert not list(tmp_path.iterdir())
