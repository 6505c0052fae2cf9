"""Defends: the advised trials are those that show what walking does not, from the forward model alone."""

import itertools
import json

import numpy as np
import pytest

from tests.subject.synthetic import write_subject
from wrapjax.cli.command_line import main
from wrapjax.cli.protocol import protocol_table
from wrapjax.diagnosis.diagnosis import diagnosis_input
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.evidence.task_covariance import ErrorSizes, TaskCovariance
from wrapjax.diagnosis.null_hypotheses.null_covariance import (
    EXPECTED_FORCE_ERROR,
    EXPECTED_REPEATABLE_ERROR,
    fixed_covariance,
    muscle_covariance,
    repeatable_covariance,
)
from wrapjax.diagnosis.protocol.detectability import Detection
from wrapjax.diagnosis.protocol.inputs import input_of_calibration
from wrapjax.diagnosis.protocol.protocol import (
    ADVISED,
    Protocol,
    advise_trials,
    protocol,
    subject_and_probabilities,
)
from wrapjax.diagnosis.protocol.result import AdvisedTrial
from wrapjax.diagnosis.protocol.trials import candidate_trials
from wrapjax.errors import InputError
from wrapjax.subject.model_alone import subject_of_model

KEPT = ("passive_joint_moment", "joint_damping", "emg_offset", "activation_dependent_fiber_length")
WITHOUT = tuple(sorted(set(CATALOGUE) - {*KEPT, "curve_family"}))


@pytest.fixture(scope="module")
def data(calibrated):
    return input_of_calibration(calibrated, diagnosis_input(calibrated, WITHOUT))


@pytest.fixture(scope="module")
def advice(data):
    return advise_trials("synthetic", "3 recorded gait cycles", data, None, 0.0)


@pytest.mark.slow
def test_every_effect_is_at_least_as_visible_after_each_trial(advice):
    assert len(advice.advised) == ADVISED and set(advice.effects) == set(KEPT)
    steps = [advice.before, *(one.detected for one in advice.advised)]
    for earlier, later in itertools.pairwise(steps):
        assert (later.detectability >= earlier.detectability - 1e-6).all()
    assert all(one.information > 0.0 for one in advice.advised)
    alone = [nats for _, nats in advice.considered]
    assert alone == sorted(alone, reverse=True) and len(alone) == len(
        {one.id for one, _ in advice.considered}
    )


@pytest.mark.slow
def test_rest_tells_of_passive_moments_and_ramps_of_active_muscles(data):
    """Relative to ramps, rest is worth more where a passive moment is undecided.

    Ramps are worth more in both cases, as errors of force of relaxed muscles are as large as passive moments.
    """
    shares = {}
    for id in ("passive_joint_moment", "activation_dependent_fiber_length"):
        undecided = advise_trials("synthetic", "", data, {id: 0.9}, 0.0)
        added = {trial.id: nats for trial, nats in undecided.considered}
        shares[id] = added["passive_knee_angle"] / added["isometric_knee_angle"]
    assert shares["passive_joint_moment"] > shares["activation_dependent_fiber_length"]


@pytest.mark.slow
def test_covariance_of_recorded_cycles_is_that_of_the_score_test(data):
    """Of candidate trials it adds rows, and changes nothing in the recorded ones."""
    rows = np.flatnonzero(data.known)
    recorded = np.flatnonzero(data.recorded)
    coordinates = np.arange(data.measured.shape[1])
    linearized = data.linearized.restricted(recorded, coordinates)
    own = rows < linearized.residual.size
    found = TaskCovariance.of(data, rows)(ErrorSizes())[np.ix_(own, own)]
    expected = (
        fixed_covariance(linearized)
        + EXPECTED_FORCE_ERROR**2 * muscle_covariance(linearized.muscle_errors)
        + EXPECTED_REPEATABLE_ERROR**2
        * repeatable_covariance(
            data.moment_size[0], data.groups[data.recorded], linearized.residual.shape[-1]
        )
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.slow
def test_only_recorded_rows_count_before(data):
    """Recorded cycles have all coordinates; a dynamometer has the one that moves."""
    assert data.measured[data.recorded].all()
    names = [trial.id for trial in data.trials]
    passive = data.trial == names.index("passive_knee_angle")
    assert data.measured[passive].sum(axis=1).tolist() == [1]
    assert data.groups[data.recorded].max() < data.groups[~data.recorded].min()


def small_protocol() -> Protocol:
    """Two effects and two trials, with the second trial telling both apart."""
    ranges = {"knee_angle_l": (0.0, 2.0)}
    first, second = candidate_trials(("knee_angle_l",), ranges)[:2]
    before, middle, after = (
        Detection(np.array(seen), np.array([[seen[0] ** 2, apart], [apart, seen[1] ** 2]]))
        for seen, apart in (((1.0, 2.5), 1.0), ((3.0, 2.5), 6.0), ((4.0, 6.0), 15.0))
    )
    return Protocol(
        name="synthetic",
        basis="3 recorded gait cycles",
        effects=("joint_damping", "emg_offset"),
        weights=np.array([0.5, 0.5]),
        before=before,
        expected_before=0.7,
        advised=(
            AdvisedTrial(first, 0.5, 2.0, middle, ()),
            AdvisedTrial(second, 0.3, 4.0, after, (("joint_damping", "emg_offset"),)),
        ),
        considered=((first, 0.5), (second, 0.4)),
        seconds=1.0,
    )


def test_page_and_json_say_what_to_record(tmp_path):
    advice = small_protocol()
    advice.save(tmp_path / "next")
    content = json.loads((tmp_path / "next" / "protocol.json").read_text())
    assert [one["id"] for one in content["trials"]] == [one.trial.id for one in advice.advised]
    assert content["trials"][1]["splits"] == [["joint_damping", "emg_offset"]]
    assert content["effects"][0]["detectability_after"] == 4.0
    for key in ("task", "experiment", "posture_deg", "effort", "minutes", "information_nats"):
        assert key in content["trials"][0]
    page = (tmp_path / "next" / "report.html").read_text()
    assert advice.advised[0].trial.what in page and "1 of 2 effects are visible" in page
    assert 'src="http' not in page and 'href="http' not in page


def test_dataset_has_each_step_at_its_label():
    advice = small_protocol()
    dataset = advice.to_dataset()
    assert all("units" in values.attrs for values in dataset.data_vars.values())
    last = dataset.sel(step=advice.advised[1].trial.id)
    assert float(last["information"]) == 0.3 and dataset.sizes["step"] == 3
    assert float(last["apart"].sel(effect="joint_damping", other="emg_offset")) == 15.0
    assert dataset["detectability"].sel(step="recorded").values.tolist() == [1.0, 2.5]


def test_table_says_what_each_trial_tells_apart():
    table = protocol_table(small_protocol())
    assert "tells apart joint_damping / emg_offset" in table
    assert "passive, 5 min" in table and "adds 0.50 nats" in table


def test_model_alone_has_an_electrode_on_every_group(tmp_path):
    model = write_subject(tmp_path / "person") / "model.osim"
    leg = subject_of_model(model, "l")
    assert set(leg.muscles.names) == {"recfem_l", "semiten_l"}
    assert leg.trials.moment_coordinates == ("hip_flexion_l", "knee_angle_l")
    with pytest.raises(InputError, match="muscles whose names end in '_r'"):
        subject_of_model(model, "r")


@pytest.mark.slow
def test_model_alone_is_advised_on(tmp_path):
    model = write_subject(tmp_path / "person") / "model.osim"
    advice = protocol(model, side="l", without=WITHOUT)
    assert np.all(advice.before.detectability == 0.0)
    assert np.median(advice.after.detectability) > 0.0
    assert "model alone" in advice.basis


def test_commands_refuse_what_is_no_subject(tmp_path, capsys):
    assert main(["protocol", str(tmp_path / "nobody")]) == 2
    assert "nobody" in capsys.readouterr().err
    model = write_subject(tmp_path / "person") / "model.osim"
    assert main(["protocol", str(model), "--side", "r", "--out", str(tmp_path / "next")]) == 2
    assert "muscles whose names end in '_r'" in capsys.readouterr().err
    assert not (tmp_path / "next").exists()


def test_a_diagnosis_gives_its_subject_and_what_it_left_undecided(tmp_path):
    write_subject(tmp_path / "person")
    gap = tmp_path / "gap"
    gap.mkdir()
    effects = [{"id": "emg_offset", "probability": 0.6}, {"id": "none", "probability": 0.4}]
    content = {"subject_folder": "../person", "effects": effects}
    (gap / "gap.json").write_text(json.dumps(content))
    subject, probabilities = subject_and_probabilities(gap)
    assert subject.name == "synthetic" and probabilities == {"emg_offset": 0.6}


def test_damaged_diagnosis_is_refused(tmp_path):
    (tmp_path / "gap.json").write_text('{"effects": [{"id": "none", "probability": 1.0}]}')
    with pytest.raises(InputError, match="found none"):
        subject_and_probabilities(tmp_path)
