"""Tests of datasets of results: numbers are at their labels, and every variable has a unit."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from tests.calibration.test_initialisation import knee_only, write_passive
from wrapjax.calibration.initialisation import Initialisation
from wrapjax.calibration.solvers.interface import Status
from wrapjax.comparison.comparison import Comparison
from wrapjax.contact_forces.contact_result import MUSCLE_SHARE, ContactResult, RunContact, Undriven
from wrapjax.evaluation.evaluation import Evaluation
from wrapjax.evaluation.stored_run import load_run
from wrapjax.geometry.exact_paths.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.model.freedom import FreedSynergies, FreedWraps, with_wraps
from wrapjax.model.parameters import QUANTITIES
from wrapjax.report.labelled.arrays import calibration_dataset, contact_dataset
from wrapjax.subject.subject import load_subject as load_subject

#: Coordinates of cycles that must have a unit; names along an axis need none.
OF_CYCLES = {"use", "speed", "time"}


def assert_all_have_units(dataset, of_cycles=OF_CYCLES):
    for name in (*dataset.data_vars, *of_cycles):
        assert "units" in dataset[name].attrs and dataset[name].attrs["long_name"], name


def test_calibration_dataset(calibrated):
    result, dataset = calibrated.result, calibrated.to_dataset()
    assert_all_have_units(dataset)
    at = {"trial": "walk_b", "muscle": "semiten_l"}
    row, trial = result.muscles.index("semiten_l"), result.trials.index("walk_b")
    np.testing.assert_array_equal(dataset["activation"].sel(at), result.states.activation[row, trial])
    np.testing.assert_array_equal(
        dataset["moment_arm"].sel(at | {"coordinate": "knee_angle_l"}),
        result.states.path.moment_arm[row, trial, result.coordinates.index("knee_angle_l")],
    )
    for name in QUANTITIES:
        assert float(dataset[name].sel(muscle="semiten_l")) == float(getattr(result.parameters, name)[row])
    # The sum of muscle moments, computed by labels, equals the joint moments.
    total = (dataset["tendon_force"] * dataset["moment_arm"]).sum("muscle")
    np.testing.assert_allclose(
        total.transpose("trial", "coordinate", "frame"), dataset["modelled_moment"], atol=1e-9
    )
    assert dataset.sel(trial="walk_b")["use"].item() == "validation" and dataset.attrs["method"] == "NGA"
    assert dataset.attrs["tendon"] == "rigid" and not {"wrap", "command"} & set(dataset.dims)


def test_calibration_dataset_with_wrap_parameters(calibrated):
    """The second muscle wraps round the first cylinder, the first muscle round the second cylinder."""
    box = np.full((2, 6), 0.5)
    wraps = FreedWraps(
        names=("ST_at_condyles_l", "RF_at_femur_l"),
        quantities=WRAP_PARAMETERS,
        units=("m", "m", "m", "rad", "rad", "1"),
        places=np.array([[1], [0]]),
        lower=-box,
        upper=box,
        scale=box,
        prior_sd=box,
    )
    result = calibrated.result
    changes = 0.01 * np.arange(12.0).reshape(2, 6)
    dataset = calibration_dataset(
        replace(
            result,
            freedom=with_wraps(result.freedom, "PGA", wraps),
            parameters=replace(result.parameters, path_changes=jnp.asarray(changes)),
            tendon="compliant",
        )
    )
    assert_all_have_units(dataset)
    for place, (name, unit) in enumerate(zip(WRAP_PARAMETERS, wraps.units, strict=True)):
        assert dataset[name].attrs["units"] == unit
        for wrap, row in (("ST_at_condyles_l", 1), ("RF_at_femur_l", 0)):
            assert float(dataset[name].sel(wrap=wrap)) == NOMINAL[place] + changes[row, place]
    assert dataset.attrs["tendon"] == "compliant"


def test_calibration_dataset_with_synergy_weights(calibrated):
    """Each muscle has its own excitation, and the excitations are in reverse order of the muscles."""
    result = calibrated.result
    weights = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    synergies = FreedSynergies(("Hamstrings", "Quadriceps"), np.array([1, 0]), 3, 100.0, 1.0)
    dataset = calibration_dataset(
        replace(
            result,
            freedom=replace(result.freedom, synergies=synergies),
            parameters=replace(result.parameters, synergy_weights=jnp.asarray(weights)),
        )
    )
    assert_all_have_units(dataset)
    found = dataset["synergy_weight"].sel(extrapolated_excitation="Quadriceps")
    assert found.sel(command="synergy_weight_2") == 2.0 and found.sel(command="synergy_offset") == 3.0
    assert dataset["synergy_weight"].sel(extrapolated_excitation="Hamstrings").values.tolist() == [4, 5, 6]


def test_contact_dataset_with_gait_phase(calibrated):
    result = calibrated.result
    trials, frames = result.time.shape
    nothing = np.zeros((0, trials, frames))
    undriven = Undriven("none", (), (), nothing, nothing, result.measured, result.measured)
    force = np.arange(trials * 2 * 3 * frames, dtype=float).reshape(trials, 2, 3, frames)
    phase = np.linspace(5.0, 105.0, trials * frames).reshape(trials, frames)
    dataset = contact_dataset(
        ContactResult(
            subject="synthetic",
            side="l",
            mass_kg=70.0,
            kind=MUSCLE_SHARE,
            reason="no ground forces",
            joints={"hip": "hip_l", "knee": "knee_l"},
            coordinates=result.coordinates,
            trials=result.trials,
            uses=result.uses,
            time=result.time,
            phase=phase,
            runs=(RunContact("NGA", "NGA", "run", True, undriven, force),),
        )
    )
    assert_all_have_units(dataset, {"use", "time", "gait_phase"})
    assert dataset["gait_phase"].attrs["units"] == "%"
    at = {"run": "NGA", "trial": "walk_b", "joint": "knee", "axis": "y"}
    knee = dataset["contact_force"].sel(at)
    row = result.trials.index("walk_b")
    np.testing.assert_array_equal(knee, force[row, 1, 1])
    np.testing.assert_array_equal(knee["gait_phase"], phase[row])


def test_evaluation_dataset(calibrated, person, tmp_path):
    calibrated.save(tmp_path / "run")
    modelled = person.trials.moments + np.array([1.0, -2.0])[:, None]
    found = Evaluation(load_run(tmp_path / "run"), person, modelled, ("one", "two"))
    dataset = found.to_dataset()
    assert_all_have_units(dataset)
    row = person.trials.names.index("walk_a/02")
    knee = dataset.sel(trial="walk_a/02", coordinate="knee_angle_l")
    np.testing.assert_array_equal(knee["measured_moment"], person.trials.moments[row, 1])
    np.testing.assert_array_equal(knee["modelled_moment"], modelled[row, 1])
    assert float(knee["mean_absolute_error"]) == pytest.approx(2.0)
    assert knee["use"].item() == "calibration" and float(knee["speed"]) == 1.1
    assert (dataset.attrs["method"], dataset.attrs["notes"]) == ("NGA", "one\ntwo")


def test_comparison_dataset(calibrated):
    """Two legs by two methods; the right leg has no knee and a different muscle."""

    result = calibrated.result
    measured = 2.0 * result.measured[:, :1]
    hip = {"coordinates": ("hip_flexion_r",), "muscles": ("vasmed_r", "recfem_r")}
    hip |= {"measured": measured, "initial_modelled": measured}

    def by(method, modelled, **changes):
        changed = replace(result, method=method, modelled=modelled, **changes)
        return replace(calibrated, result=changed)

    left = [by("NGA", result.measured + 4.0), by("SGA", result.measured + 0.5)]
    right = [by("NGA", measured + 3.0, **hip), by("SGA", measured - 1.0, **hip)]
    dataset = Comparison(
        ("NGA", "SGA"), (tuple(left), tuple(right)), ("person_left", "person_right")
    ).to_dataset()
    assert_all_have_units(dataset)
    assert dataset["coordinate"].values.tolist() == ["hip_flexion", "knee_angle"]
    assert dataset["muscle"].values.tolist() == ["recfem", "semiten", "vasmed"]
    assert dataset.sizes["trial"] == 6
    errors = dataset["mean_absolute_error"].sel(calibration_method="SGA")
    of_legs = errors.groupby("leg_of_trial").mean()
    assert float(of_legs.sel(leg_of_trial="person_left", coordinate="knee_angle")) == pytest.approx(0.5)
    assert float(of_legs.sel(leg_of_trial="person_right", coordinate="hip_flexion")) == pytest.approx(1.0)
    assert errors.sel(trial="person_right/walk_b", coordinate="knee_angle").isnull()
    row = result.trials.index("walk_b")
    np.testing.assert_array_equal(
        dataset["measured_moment"].sel(trial="person_right/walk_b", coordinate="hip_flexion"),
        measured[row, 0],
    )
    np.testing.assert_array_equal(dataset["time"].sel(trial="person_right/walk_b"), result.time[row])
    scale = dataset["emg_scale"].sel(calibration_method="NGA", leg="person_right")
    own = np.asarray(result.parameters.emg_scale)
    assert float(scale.sel(muscle="vasmed")) == own[0] and float(scale.sel(muscle="recfem")) == own[1]
    assert scale.sel(muscle="semiten").isnull() and scale.attrs["units"] == QUANTITIES["emg_scale"].unit


def test_initialisation_dataset(tmp_path):
    person = load_subject(write_passive(tmp_path / "person", knee_only))
    before = person.muscles
    after = replace(before, optimal_fiber_length=1.1 * before.optimal_fiber_length)
    passive = np.arange(3.0 * 2 * 51).reshape(3, 2, 51)
    passive[0, 0] = np.nan
    ranges = np.array([[[0.5, 0.9], [0.6, 1.0]], [[0.7, 1.1], [0.8, 1.2]]])
    found = Initialisation(person, before, after, (), ranges, passive, {}, Status.cost)
    dataset = found.to_dataset()
    assert_all_have_units(dataset, {"passive_trial"})
    at = {"muscle": "semiten_l", "stage": "after"}
    assert float(dataset["optimal_fiber_length"].sel(at)) == after.optimal_fiber_length[1]
    assert float(dataset["tendon_slack_length"].sel(at)) == before.tendon_slack_length[1]
    ends = [float(dataset[f"{end}_normalized_fiber_length"].sel(at)) for end in ("shortest", "longest")]
    assert ends == [0.8, 1.2] and dataset["optimal_fiber_length"].attrs["units"] == "m"
    knee = dataset["modelled_passive_moment"].sel(stage="after", coordinate="knee_angle_l")
    np.testing.assert_array_equal(knee, passive[2, 1])
    assert set(knee["passive_trial"].values) == {"knee"}
    assert dataset["measured_passive_moment"].sel(coordinate="hip_flexion_l").isnull().all()
    assert dataset.attrs["status"] == Status.cost.value
