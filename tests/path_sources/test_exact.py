"""PGA with the exact engine: recovery, bounds, and the personalised model in OpenSim."""

from dataclasses import replace

import jax
import numpy as np
import opensim
import pytest

from tests.path_sources.hidden_cylinders import errors_of_identifiable_arms, hidden
from tests.path_sources.round_trip import assert_reproduces_itself
from tests.subject.synthetic import (
    add_muscle,
    add_muscle_parameters,
    write_subject,
    write_wrapped_subject,
)
from wrapjax.calibration.calibration import calibrate
from wrapjax.calibration.problem import build_leg_setups, build_objective, build_stages
from wrapjax.calibration.solvers.interface import Status
from wrapjax.cli.command_line import main
from wrapjax.errors import InputError
from wrapjax.evaluation.stored_run import load_run
from wrapjax.geometry.exact_paths.engine import PARITY, ExactPaths, wrap_at_samples
from wrapjax.geometry.exact_paths.wrapping import NOMINAL
from wrapjax.geometry.surrogates.wrap_bounds import NARROWER_TRANSLATIONS, WIDER_TRANSLATIONS
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.path_sources.exact import exact_geometry
from wrapjax.subject.subject import load_subject as load_subject

#: Muscle parameters of the subject's table (N, m, m, rad), which differ from those of its model.
TABLE = {
    "recfem_l": (1712.25, 0.1, 0.3, 0.34),
    "semiten_l": (812.5, 0.15, 0.25, 0.0),
    "vasint_l": (655.0, 0.093, 0.311, 0.21),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    person = write_wrapped_subject(tmp_path_factory.mktemp("wrapped") / "synthetic")
    add_muscle(person, "vasint_l", 0.04)
    add_muscle_parameters(person, *((name, *values) for name, values in TABLE.items()))
    return person


@pytest.fixture(scope="module")
def subject(folder):
    """Subject with three muscles, one of which wraps round a cylinder and another has no electrode."""
    return load_subject(folder)


@pytest.fixture(scope="module")
def geometry(subject):
    return exact_geometry(subject)


@pytest.fixture(scope="module")
def run(folder, tmp_path_factory):
    """Run folder of the command line."""
    out = tmp_path_factory.mktemp("runs") / "PGA"
    arguments = ["calibrate", str(folder), "--method", "PGA", "--geometry", "engine", "--starts", "1"]
    assert main([*arguments, "--out", str(out), "--quiet"]) == 0
    return out


def test_touched_wraps_are_free_within_their_bounds(subject, geometry):
    assert geometry.touching == ("semiten_l",)
    wraps = geometry.freedom("PGA", subject).wraps
    (name,) = wraps.names
    assert wraps.places.tolist() == [[-1], [0]]
    assert geometry.translations[name] in (*NARROWER_TRANSLATIONS, *WIDER_TRANSLATIONS)
    np.testing.assert_allclose(wraps.upper[0, 3:], [np.radians(20), np.radians(20), 0.2])
    assert geometry.freedom("NGA", subject).wraps is None


def test_functions_compiled_for_nga_are_reused_by_the_first_stage(subject, geometry):
    """Leaves and shapes do not depend on the freedom of the later stage."""
    plain, held = build_objective(subject, "NGA", geometry), build_stages(subject, "PGA", geometry)[0]
    assert jax.tree.structure(held) == jax.tree.structure(plain)
    assert [np.shape(leaf) for leaf in jax.tree.leaves(held)] == [
        np.shape(leaf) for leaf in jax.tree.leaves(plain)
    ]


def test_paths_are_nominal_after_an_interrupted_first_stage(subject, geometry):
    def stop(start, iteration, state):
        if iteration.number:
            raise KeyboardInterrupt

    stopped = calibrate(subject, "PGA", geometry, starts=1, callback=stop)
    assert stopped.status is Status.interrupted
    result = stopped.result
    changes = np.asarray(result.parameters.path_changes)
    assert changes.shape == (2, 6) and not changes.any()
    np.testing.assert_array_equal(result.states.path.length, result.initial_states.path.length)


def test_evaluation_reproduces_the_run(run, subject):
    """With the calibrated wraps."""
    assert not (run / "paths.npz").exists()
    assert_reproduces_itself(run, subject)


def test_command_calibrates_wraps(run):
    rows = [line.split(",") for line in (run / "parameters.csv").read_text().splitlines()]
    wraps = {row[2]: [float(value) for value in (row[3], row[5], row[6])] for row in rows if row[1] == "wrap"}
    assert list(wraps) == [
        *("translation_x_m", "translation_y_m", "translation_z_m"),
        *("rotation_x_rad", "rotation_y_rad", "radius_factor"),
    ]
    assert all(lower <= value <= upper for value, lower, upper in wraps.values())
    nominal = dict(zip(wraps, NOMINAL, strict=True))
    assert any(abs(value - nominal[name]) > 1e-3 for name, (value, _, _) in wraps.items())


def test_true_wrap_parameters_are_recovered(subject, geometry):
    """Without noise, with all muscle parameters free."""
    problem = build_objective(subject, "PGA", geometry)
    wraps = geometry.freedom("PGA", subject).wraps
    true_wraps = {wraps.names[0]: NOMINAL + [0.003, 0.002, 0.0, 0.05, -0.05, 0.05]}
    gains = problem.variables.base.emg_scale * np.array([0.9, 1.15])
    before, after = errors_of_identifiable_arms(*hidden(problem, wraps, true_wraps, emg_scale=gains))
    assert before.size
    assert after.mean() < 0.4 * before.mean()


def test_personalised_model_has_the_paths_of_the_calibration(subject, geometry, run):
    """Compare lengths and moment arms of OpenSim over the recorded cycles."""
    coordinates = geometry.engine.coordinates
    columns = [subject.trials.coordinates.index(name) for name in coordinates]
    poses = np.moveaxis(subject.trials.angles[:, columns], 1, -1).reshape(-1, len(coordinates))
    written = analyse_muscles(run / "model_personalized.osim", ("semiten_l",), coordinates, poses)
    rows = [line.split(",") for line in (run / "parameters.csv").read_text().splitlines()]
    found = np.array([[[float(row[3]) for row in rows if row[1] == "wrap"]]])
    engine = ExactPaths(describe_model(subject.model_file), ("semiten_l",), coordinates)
    posed = engine.posed(poses)["semiten_l"]
    parity, shortest = wrap_at_samples(posed, found, PARITY), wrap_at_samples(posed, found)
    assert shortest.touching.any()
    np.testing.assert_allclose(written.length[:, 0], parity.length[0], atol=1e-6)
    np.testing.assert_allclose(written.moment_arm[:, :, 0], parity.moment_arm[0], atol=1e-6)
    assert np.sqrt(np.mean((written.length[:, 0] - shortest.length[0]) ** 2)) < 0.5e-3
    assert np.sqrt(np.mean((written.moment_arm[:, :, 0] - shortest.moment_arm[0]) ** 2)) < 1e-3
    # With the nominal wrap the lengths differ.
    nominal = analyse_muscles(subject.model_file, ("semiten_l",), coordinates, poses)
    assert np.abs(nominal.length - written.length).max() > 1e-4


def test_personalised_model_has_the_muscles_of_the_calibration(subject, run):
    """The table has precedence over the model, for muscles without an electrode as well."""
    model, found = opensim.Model(str(run / "model_personalized.osim")), {}
    for muscle in map(model.getMuscles().get, range(model.getMuscles().getSize())):
        found[muscle.getName()] = (
            muscle.get_max_isometric_force(),
            muscle.get_optimal_fiber_length(),
            muscle.get_tendon_slack_length(),
            muscle.get_pennation_angle_at_optimal(),
        )
    calibrated = load_run(run)
    names = ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length", "pennation_angle")
    table = np.array([calibrated.values[name] for name in names]).T.tolist()
    expected = dict(zip(calibrated.muscles, map(tuple, table), strict=True))
    for muscle, values in expected.items():
        strength, fiber, tendon, pennation = TABLE[muscle]
        assert (values[0], values[3]) == (strength, pennation), "held"
        assert values[1] != fiber and values[2] != tendon, "calibrated"
    assert subject.undriven_muscles == ("vasint_l",)
    assert found == {**expected, "vasint_l": TABLE["vasint_l"]}


def test_polynomials_of_the_same_paths_give_the_same_calibration(subject, geometry):
    """NGA gives similar results with both sources of the same paths."""
    exact = calibrate(subject, "NGA", geometry, starts=1)
    fitted = calibrate(subject, "NGA", starts=1)
    error = np.abs(exact.result.modelled - fitted.result.modelled).mean()
    assert error < 0.05 * np.abs(exact.result.modelled).mean()


def test_methods_that_adjust_polynomials_are_refused(subject, geometry):
    with pytest.raises(InputError, match="SGA changes polynomials, and the exact engine has none"):
        calibrate(subject, "SGA", geometry)


def test_missing_wraps_are_reported(tmp_path):
    plain = load_subject(write_subject(tmp_path / "plain"))
    with pytest.raises(InputError, match="no driven muscle touches a wrapping surface"):
        exact_geometry(plain).freedom("PGA", plain)


def test_untouched_wraps_are_free_on_request(subject, geometry):
    """Bounds of touched wraps are unchanged."""
    untouched = replace(geometry, translations={})
    with pytest.raises(InputError, match="no driven muscle touches a wrapping surface"):
        untouched.freedom("PGA", subject)
    touched, everything = (one.freedom("PGA", subject, "all").wraps for one in (geometry, untouched))
    assert everything.names == touched.names
    np.testing.assert_array_equal(everything.upper, touched.upper)
    problem = build_leg_setups(subject, untouched, "PGA", None, surfaces="all")[0]
    assert problem.freedom.wraps.names == touched.names
    with pytest.raises(ValueError, match="expected one of touched, all"):
        calibrate(subject, "PGA", geometry, surfaces="some")


def test_surfaces_are_an_option_of_pga_alone(folder, tmp_path, capsys):
    arguments = ["calibrate", str(folder), "--method", "NGA", "--surfaces", "all"]
    assert main([*arguments, "--out", str(tmp_path / "run")]) == 2
    assert "the other methods change no wrapping surfaces" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_unknown_geometry_is_refused(subject):
    with pytest.raises(ValueError, match="expected one of engine, engine-parity"):
        exact_geometry(subject, "surrogate")


def test_a_fit_with_the_exact_engine_is_refused(folder, tmp_path, capsys):
    arguments = ["calibrate", str(folder), "--method", "PGA", "--geometry", "engine"]
    assert main([*arguments, "--fit", str(tmp_path), "--out", str(tmp_path / "run")]) == 2
    assert "the exact engine needs no fit" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
