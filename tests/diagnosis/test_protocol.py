"""Defends: the advised trials are those that show what walking does not, from the forward model alone."""

import json

import numpy as np
import pytest

from tests.subject.synthetic import write_subject
from wrapjax.diagnosis.protocol import ADVISED, advise_trials, protocol, subject_and_probabilities
from wrapjax.diagnosis.protocol_inputs import input_of_calibration
from wrapjax.errors import InputError
from wrapjax.report.protocol_page import describe_protocol, render_protocol
from wrapjax.subject.model_alone import subject_of_model

KEPT = ("passive_joint_moment", "joint_damping", "emg_offset", "activation_dependent_fiber_length")


@pytest.fixture(scope="module")
def without():
    from wrapjax.diagnosis.effects.catalogue import CATALOGUE

    return tuple(sorted(set(CATALOGUE) - {*KEPT, "curve_family"}))


@pytest.fixture(scope="module")
def data(calibrated, without):
    return input_of_calibration(calibrated, without)


@pytest.fixture(scope="module")
def advice(data):
    return advise_trials("synthetic", "3 recorded gait cycles", data, None, 0.0)


def test_every_effect_is_at_least_as_visible_after_each_trial(advice):
    assert len(advice.advised) == ADVISED and set(advice.effects) == set(KEPT)
    steps = [advice.before, *(one.detected for one in advice.advised)]
    for earlier, later in zip(steps[:-1], steps[1:], strict=True):
        assert (later.detectability >= earlier.detectability - 1e-6).all()
    assert all(one.information > 0.0 for one in advice.advised)
    alone = [nats for _, nats in advice.considered]
    assert alone == sorted(alone, reverse=True) and len(alone) == len({one.id for one, _ in advice.considered})


def test_a_passive_moment_left_undecided_asks_for_a_passive_trial(data):
    """No muscle is active there, so that what remains is the joint's and the passive fibers'."""
    undecided = advise_trials("synthetic", "", data, {"passive_joint_moment": 0.9}, 0.0)
    assert undecided.advised[0].trial.task == "passive"
    place = undecided.effects.index("passive_joint_moment")
    detectability = [undecided.before, undecided.advised[0].detected]
    before, after = (one.detectability[place] for one in detectability)
    assert after > 1.2 * before


def test_only_recorded_rows_count_before(data):
    """Recorded cycles have all coordinates; a dynamometer has the one that moves."""
    assert data.measured[data.recorded].all()
    names = [trial.id for trial in data.trials]
    passive = data.trial == names.index("passive_knee_angle")
    assert data.measured[passive].sum(axis=1).tolist() == [1]
    assert data.groups[data.recorded].max() < data.groups[~data.recorded].min()


def test_page_and_json_say_what_to_record(advice):
    content = json.loads(json.dumps(describe_protocol(advice)))
    assert [one["id"] for one in content["trials"]] == [one.trial.id for one in advice.advised]
    for key in ("task", "experiment", "posture_deg", "effort", "minutes", "information_nats", "splits"):
        assert key in content["trials"][0]
    page = render_protocol(advice)
    assert advice.advised[0].trial.what in page and "http" not in page.split("</style>")[1].split("data:")[0]


def test_model_alone_has_an_electrode_on_every_group(tmp_path):
    model = write_subject(tmp_path / "person") / "model.osim"
    leg = subject_of_model(model, "l")
    assert set(leg.muscles.names) == {"recfem_l", "semiten_l"}
    assert leg.trials.moment_coordinates == ("hip_flexion_l", "knee_angle_l")
    with pytest.raises(InputError, match="muscles whose names end in '_r'"):
        subject_of_model(model, "r")


def test_model_alone_is_advised_on(tmp_path, without):
    model = write_subject(tmp_path / "person") / "model.osim"
    advice = protocol(model, side="l", without=without)
    assert np.all(advice.before.detectability == 0.0)
    assert np.median(advice.after.detectability) > 0.0
    assert "model alone" in advice.basis


def test_damaged_diagnosis_is_refused(tmp_path):
    (tmp_path / "gap.json").write_text('{"effects": [{"id": "none", "probability": 1.0}]}')
    with pytest.raises(InputError, match="found none"):
        subject_and_probabilities(tmp_path)
