"""Initial lengths of a subject: result, files, and invalid passive trials."""

import json

import numpy as np
import pytest

from tests.subject.synthetic import COORDINATES, write_subject
from wrapjax.calibration.initialisation import initialise
from wrapjax.errors import InputError
from wrapjax.io.storage import Storage, write_storage
from wrapjax.subject.subject import load_subject as load_subject

PASSIVE = """
[[passive]]
name = "knee"
angles = "passive/angles.sto"
moments = "passive/moments.sto"
"""


def write_passive(folder, moments, columns=("hip_flexion_l_moment", "knee_angle_l_moment")):
    """Write a subject with a passive trial of knee flexion at a hip angle of 0.3 rad."""
    write_subject(folder)
    time = np.linspace(0.0, 10.0, 51)
    angles = np.stack([0.3 + 0.0 * time, 0.1 + 0.15 * time])
    write_storage(folder / "passive" / "angles.sto", Storage("angles", COORDINATES, time, angles.T))
    write_storage(folder / "passive" / "moments.sto", Storage("moments", columns, time, moments(time).T))
    settings = folder / "subject.toml"
    settings.write_text(settings.read_text() + PASSIVE)
    return folder


def knee_only(time):
    return np.stack([0.0 * time, -2.0 * np.expm1(0.2 * time)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_passive(tmp_path_factory.mktemp("passive") / "person", knee_only)


@pytest.fixture(scope="module")
def found(folder):
    return initialise(load_subject(folder))


def test_columns_of_zeros_count_as_missing(folder):
    (trial,) = load_subject(folder).passive
    assert (trial.coordinates, trial.moment_coordinates) == (COORDINATES, ("knee_angle_l",))
    np.testing.assert_allclose(trial.moments[0], knee_only(np.linspace(0.0, 10.0, 51))[1])


def test_errors_of_passive_moments_decrease(found):
    assert found.status.converged
    assert list(found.passive_mae) == ["knee_angle_l"]
    before, after = found.passive_mae["knee_angle_l"]
    assert after < before
    assert not any("No [[passive]]" in note for note in found.notes)


def test_settings_can_refer_to_the_written_table(found, folder, tmp_path):
    found.save(tmp_path / "lengths")
    page = (tmp_path / "lengths" / "report.html").read_text()
    assert page.count('<img alt="') == 2 and "knee: knee_angle_l" not in page and "recfem_l" in page
    content = json.loads((tmp_path / "lengths" / "initialisation.json").read_text())
    assert list(content["muscles"]) == ["recfem_l", "semiten_l"]
    (folder / "lengths.csv").write_bytes((tmp_path / "lengths" / "muscle_parameters.csv").read_bytes())
    settings = folder / "subject.toml"
    named = settings.read_text().replace("[model]", '[model]\nmuscle_parameters = "lengths.csv"')
    settings.write_text(named)
    muscles = load_subject(folder).muscles
    np.testing.assert_array_equal(muscles.optimal_fiber_length, found.after.optimal_fiber_length)
    np.testing.assert_array_equal(muscles.tendon_slack_length, found.after.tendon_slack_length)


def test_a_note_reports_missing_passive_trials(person):
    found = initialise(person)
    assert found.passive_mae == {} and "passive_moment" not in found.cost_by_term
    assert found.notes[0].startswith("No [[passive]] trial: lengths follow from operating ranges")
    assert np.abs(found.ranges[1, :, 1] - 1.0).max() < np.abs(found.ranges[0, :, 1] - 1.0).max() + 0.05


@pytest.mark.parametrize(
    ("moments", "columns", "message"),
    [
        (lambda time: np.zeros((2, time.size)), None, "expected a moment that is not zero about one of"),
        (lambda time: 1e4 * knee_only(time), None, "are the moments in N mm"),
        (knee_only, ("a_moment", "b_moment"), "expected a moment that is not zero about one of"),
    ],
)
def test_invalid_moments_are_refused(tmp_path, moments, columns, message):
    given = {} if columns is None else {"columns": columns}
    with pytest.raises(InputError, match=message):
        load_subject(write_passive(tmp_path / "unfit", moments, **given))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("passive/angles.sto", "passive/nowhere.sto", "nowhere.sto: does not exist"),
        ('moments = "passive/moments.sto"', "", r"\[\[passive\]\] 'knee' moments: expected text"),
        ("[[passive]]", "[passive]", r"expected tables \[\[passive\]\]"),
        ('name = "knee"', 'name = "knee"\nemg = "x.sto"', "'knee' emg: is not a known key"),
    ],
)
def test_invalid_settings_are_refused(tmp_path, old, new, message):
    folder = write_passive(tmp_path / "unfit", knee_only)
    settings = folder / "subject.toml"
    settings.write_text(settings.read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        load_subject(folder)
