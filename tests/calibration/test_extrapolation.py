"""Calibration of a muscle without an electrode by synergies, its run folder and later use."""

import dataclasses
import json

import numpy as np
import pytest

from tests.subject.synthetic import write_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.contact_forces.contact_force import contact
from wrapjax.errors import InputError
from wrapjax.evaluation.evaluation import evaluate
from wrapjax.evaluation.stored_run import load_run
from wrapjax.path_sources.undriven_muscles import apply_undriven_strategy
from wrapjax.subject.subject import load_subject as load_subject

CHANNEL = 'SemiTen = ["semiten_l"]\n'


def without_channel(folder, extra=""):
    """Write a subject whose semitendinosus has no electrode."""
    settings = write_subject(folder) / "subject.toml"
    settings.write_text(settings.read_text().replace(CHANNEL, extra))
    return load_subject(folder)


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    return without_channel(tmp_path_factory.mktemp("bare") / "person")


@pytest.fixture(scope="module")
def driven(bare, paths):
    return calibrate(bare, "NGA", paths, starts=1, undriven="synergies", synergies=1)


@pytest.fixture(scope="module")
def folder(driven, tmp_path_factory):
    run = tmp_path_factory.mktemp("runs") / "run"
    driven.save(run)
    return run


def test_left_returns_the_subject_unchanged(bare):
    assert apply_undriven_strategy(bare) is bare
    with pytest.raises(ValueError, match="unknown strategy 'some'"):
        apply_undriven_strategy(bare, "some")


def test_muscles_without_a_channel_follow_those_with_one(bare):
    subject = apply_undriven_strategy(bare, "synergies", 1)
    assert subject.muscles.names == ("recfem_l", "semiten_l")
    assert (subject.undriven_muscles, subject.channel_of) == ((), {"recfem_l": "RecFem"})
    assert subject.synergies.groups == {"semiten_l": ("semiten_l",)}
    assert apply_undriven_strategy(subject, "synergies", 1) is subject


def test_validation_cycles_do_not_affect_synergies(bare):
    trials = bare.trials
    emg = np.where(np.array(trials.uses)[:, None, None] == "validation", 7.0, trials.emg)
    other = dataclasses.replace(bare, trials=dataclasses.replace(trials, emg=emg))
    found, again = (apply_undriven_strategy(one, "synergies", 1).synergies.basis for one in (bare, other))
    np.testing.assert_array_equal(found.components, again.components)
    np.testing.assert_array_equal(found.largest, again.largest)


def test_the_driven_muscle_reduces_the_moment_error(bare, paths, driven):
    left = calibrate(bare, "NGA", paths, starts=1)
    assert left.result.muscles == ("recfem_l",)
    errors = [np.abs(run.result.modelled - run.result.measured)[:2].mean() for run in (left, driven)]
    assert errors[1] < 0.9 * errors[0]
    excitation = driven.result.states.excitation[1]
    assert excitation.min() >= 0.0 and excitation.max() <= 1.0 and np.ptp(excitation) > 0.05


def test_the_run_folder_records_the_excitation_of_each_muscle(folder):
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["drive"] == {
        "recfem_l": {"by": "electrode", "signal": "RecFem"},
        "semiten_l": {"by": "synergies", "signal": "semiten_l"},
    }
    assert "semiten_l,synergy,synergy_offset," in (folder / "parameters.csv").read_text()
    report = (folder / "report.html").read_text()
    assert "Drive of the muscles" in report and "1 principal component of" in report


def test_a_loaded_run_reproduces_its_moments(bare, driven, folder):
    np.testing.assert_allclose(evaluate(load_run(folder), bare).modelled, driven.result.modelled, atol=1e-9)


def test_evaluation_on_unsuitable_subjects_is_refused(person, folder, tmp_path):
    with pytest.raises(InputError, match=r"'semiten_l' without a channel.* found a channel that drives it"):
        evaluate(load_run(folder), person)
    other = without_channel(tmp_path / "other")
    trials = dataclasses.replace(other.trials, channels=("Vasti",))
    with pytest.raises(InputError, match="lacks EMG channel 'RecFem', which the synergies"):
        evaluate(load_run(folder), dataclasses.replace(other, trials=trials))


def test_contact_uses_calibrated_forces(driven, folder):
    """Static optimization leaves the forces of driven muscles unchanged."""
    result = contact(folder).result
    assert result.runs[0].undriven.muscles == () and result.runs[0].undriven.without_force == ()
    force = np.asarray(driven.result.states.fiber.tendon_force)
    # Both muscles compress the knee with their full force, one at an angle to the other.
    pressed = result.runs[0].magnitude[:, 1]
    assert (pressed <= force.sum(axis=0) + 1e-6).all() and (pressed >= 0.9 * force.sum(axis=0)).all()


def test_settings_define_shared_excitations(tmp_path):
    subject = without_channel(tmp_path / "named", '[emg.extrapolated]\nback = ["semiten_l"]\n')
    assert apply_undriven_strategy(subject, "synergies", 1).synergies.groups == {"back": ("semiten_l",)}


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (
            '[emg.extrapolated]\nback = ["semiten_r"]\n',
            r"\[emg.extrapolated\] back: muscle 'semiten_r'",
        ),
        ('[emg.extrapolated]\nback = ["recfem_l"]\n', "found 'recfem_l', which has channel 'RecFem'"),
        ('[emg.extrapolated]\na = ["semiten_l"]\nb = ["semiten_l"]\n', "'semiten_l', which has 'a'"),
        ('[emg.extrapolated]\nback = "semiten_l"\n', "expected a list of names"),
        ("extrapolated = 3\n", "expected a table"),
    ],
)
def test_invalid_settings_are_refused(tmp_path, extra, message):
    if extra.startswith("extrapolated"):
        folder = write_subject(tmp_path / "unfit")
        settings = folder / "subject.toml"
        settings.write_text(
            settings.read_text().replace('kind = "envelope"\n', f'kind = "envelope"\n{extra}')
        )
        with pytest.raises(InputError, match=message):
            load_subject(folder)
        return
    with pytest.raises(InputError, match=message):
        without_channel(tmp_path / "unfit", extra)


def test_muscles_that_cannot_be_driven_are_refused(person, bare):
    with pytest.raises(InputError, match="2 synergies were asked for"):
        apply_undriven_strategy(bare, "synergies", 2)
    with pytest.raises(InputError, match="no muscle without a channel"):
        apply_undriven_strategy(person, "synergies", 2)
    nowhere = dataclasses.replace(bare, extrapolated={"back": ("nowhere_l",)})
    with pytest.raises(InputError, match="'nowhere_l' cannot be driven"):
        apply_undriven_strategy(nowhere, "synergies", 1)
    with pytest.raises(InputError, match="expected at least one excitation"):
        apply_undriven_strategy(dataclasses.replace(bare, extrapolated={}), "synergies", 1)
