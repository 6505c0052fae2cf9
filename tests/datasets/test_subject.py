"""A virtual subject's folder has physiological moments, which the true parameters explain."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from wrapjax.datasets.virtual_person.anatomy import COORDINATES
from wrapjax.datasets.virtual_person.true_parameters import draw_true_parameters, parameter_names
from wrapjax.datasets.virtual_person.virtual_subject import Series, write_virtual_subject
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.io.storage import read_storage
from wrapjax.model.forward import Recording, muscle_states
from wrapjax.model.parameters import initial_parameters
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.excitation import fit_emg_spline
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.subject.subject import load_subject


@pytest.fixture(scope="module")
def subject(clean_folder):
    return load_subject(clean_folder)


@pytest.fixture(scope="module")
def path(subject):
    """Muscle paths at the stored angles, whose first and last 8 frames are outside the cycle."""
    lengths, rates, arms = [], [], []
    for recording in subject.recordings:
        table = read_storage(recording.angles)
        muscles = subject.muscles.names
        geometry = analyse_muscles(
            subject.model_file, muscles, table.columns, np.radians(table.values), quiet=True, processes=1
        )
        lengths.append(geometry.length[8:-8].T)
        rates.append(CubicSpline(table.time, geometry.length)(table.time[8:-8], 1).T)
        arms.append(np.transpose(geometry.moment_arm[8:-8], (2, 1, 0)))
    return PathState(*(jnp.asarray(np.stack(values, axis=1)) for values in (lengths, rates, arms)))


@pytest.fixture(scope="module")
def states(subject, clean_truth, path):
    """Forward model with the true parameters on the stored recordings."""
    trials, muscles = subject.trials, subject.muscles
    start = initial_parameters(
        jnp.asarray(muscles.max_isometric_force),
        jnp.asarray(muscles.optimal_fiber_length),
        jnp.asarray(muscles.tendon_slack_length),
        jnp.asarray(muscles.pennation_angle),
    )
    true_values = {name: jnp.asarray(getattr(clean_truth, name)) for name in parameter_names()}
    parameters = type(start)(**{**vars(start), **true_values})
    splines = fit_emg_spline(trials.emg_time, trials.emg)
    emg = jax.tree.map(lambda leaf: leaf[np.array(subject.muscle_channels)], splines)
    return muscle_states(HILL_CURVES["paper"], parameters, Recording(emg, fixed_path(path), trials.padding))


def test_folder_is_read_without_notes(subject, clean_truth):
    assert subject.notes == ()
    assert subject.undriven_muscles == ()
    assert subject.muscles.names == clean_truth.muscles
    assert subject.trials.uses == ("calibration", "validation")
    assert subject.trials.moment_coordinates == COORDINATES
    assert subject.trials.emg.max(axis=(0, 2)) == pytest.approx(1.0)
    assert any(set(group) == {"gaslat_r", "gasmed_r", "soleus_r"} for group in subject.fiber_length_groups)


def test_true_parameters_reproduce_the_moments(subject, states):
    """Grids, delays, units and orders of the files must not change moments by a micronewton meter."""
    modelled = np.asarray(states.moment.sum(axis=0))
    assert np.abs(modelled - subject.trials.moments).max() < 1e-6


def test_velocities_agree_with_the_chain_rule(subject, path):
    """A calibration computes velocities from joint velocities; the simulation computes them from lengths."""
    chained = -np.einsum("mtcf,tcf->mtf", path.moment_arm, subject.trials.angular_velocities)
    error = np.abs(chained - path.velocity)
    assert np.sqrt(np.mean(error**2)) < 2e-4
    # Where semitendinosus lifts off the tibia its moment arm has a corner, which a spline rounds off.
    assert error.max() < 0.01


def test_moments_are_physiological(subject):
    """Winter 1991, N m/kg: ankle -1.2 to -1.7 at push-off; hip and knee within 1.2."""
    moments = dict(zip(COORDINATES, subject.trials.moments[-1] / subject.mass_kg, strict=True))
    assert -1.7 < moments["ankle_angle_r"].min() < -1.1
    assert 42 <= moments["ankle_angle_r"].argmin() <= 52
    assert 0.3 < moments["hip_flexion_r"].max() < 1.2
    assert -1.2 < moments["hip_flexion_r"].min() < -0.3
    assert -1.0 < moments["knee_angle_r"][5:30].min() < -0.25
    assert -1.2 < moments["hip_adduction_r"][10:45].min() < -0.3
    assert max(np.abs(moments[name]).max() for name in ("hip_rotation_r", "subtalar_angle_r")) < 0.3


def test_fibers_and_excitations_are_feasible(states):
    length = np.asarray(states.fiber.normalized_length)
    assert length.min() > 0.3
    assert length.max() < 1.3
    assert np.asarray(states.excitation).max() <= 1.0
    assert np.asarray(states.activation).min() >= 0.0


def test_same_seed_same_bytes(tmp_path):
    series = (Series(1.2, 1, 0),)
    for name, seed in (("one/v", 5), ("two/v", 5), ("other/v", 6)):
        write_virtual_subject(tmp_path / name, seed=seed, series=series)

    def content(name):
        folder = tmp_path / name
        return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    one, two, other = (content(name) for name in ("one/v", "two/v", "other/v"))
    assert one == two
    assert {str(p) for p in one if one[p] == other[p]} == {"model.osim"}


def test_noise_has_the_requested_size(tmp_path, clean_folder, subject):
    noisy_folder = tmp_path / "noisy"
    series = (Series(0.8, 1, 0), Series(1.2, 0, 1))
    write_virtual_subject(noisy_folder, seed=3, emg_noise=0.2, moment_noise=4.0, series=series)
    noisy = load_subject(noisy_folder)
    moment_error = noisy.trials.moments - subject.trials.moments
    assert moment_error.std() == pytest.approx(4.0, rel=0.25)
    # Noise is smooth: successive frames are similar.
    assert np.diff(moment_error, axis=-1).std() < 0.3 * moment_error.std()
    high = subject.trials.emg > 0.5
    ratio = np.log(noisy.trials.emg[high] / subject.trials.emg[high])
    assert ratio.std() == pytest.approx(0.2, rel=0.35)
    assert noisy.trials.emg.min() > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_true_parameters_are_usually_feasible(seed, path, subject):
    """Fiber lengths of any person stay within the limits of a calibration (0.3 to 1.3)."""
    truth = draw_true_parameters(np.random.default_rng(seed))
    reach = truth.optimal_fiber_length * np.cos(subject.muscles.pennation_angle)
    fiber = (np.asarray(path.length) - truth.tendon_slack_length[:, None, None]) / reach[:, None, None]
    assert fiber.min() > 0.3
    assert fiber.max() < 1.3
