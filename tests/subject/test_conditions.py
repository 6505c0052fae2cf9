"""Two conditions of a person, from two folders or from one, with shared maxima of EMG."""

import numpy as np
import pytest

from tests.subject.synthetic import write_subject
from wrapjax.errors import InputError
from wrapjax.io.storage import Storage, read_storage, write_storage
from wrapjax.subject.conditions import load_conditions


def test_two_folders_are_one_subject(tmp_path):
    first, second = write_subject(tmp_path / "brace"), write_subject(tmp_path / "plain")
    subject, names = load_conditions(first, second)
    assert names == ("brace", "plain")
    assert subject.folder == first
    assert subject.trials.conditions == ("brace",) * 3 + ("plain",) * 3
    assert subject.trials.names[:3] == ("walk_a/01", "walk_a/02", "walk_b")
    assert len(set(subject.trials.names)) == 6
    assert subject.recordings[2].angles == second / "trials" / "walk_a" / "angles.sto"


def test_raw_emg_is_normalised_over_both_conditions(tmp_path):
    """Twice the EMG in one condition stays twice as large."""
    folders = [write_subject(tmp_path / name) for name in ("brace", "plain")]
    generator = np.random.default_rng(0)
    time = np.arange(4001) / 1000.0
    noise = 1e-4 * generator.standard_normal((time.size, 2))
    for folder, gain in zip(folders, (1.0, 2.0), strict=True):
        for trial in ("walk_a", "walk_b"):
            file = folder / "trials" / trial / "emg.sto"
            columns = read_storage(file).columns
            write_storage(file, Storage("emg", columns, time, gain * noise))
        settings = folder / "subject.toml"
        settings.write_text(settings.read_text().replace('kind = "envelope"', 'kind = "raw"'))
    subject, _ = load_conditions(*folders)
    np.testing.assert_allclose(subject.trials.emg[3:], 2.0 * subject.trials.emg[:3], rtol=1e-9)
    assert subject.trials.emg.max() == pytest.approx(1.0)


def test_two_conditions_of_one_folder(tmp_path):
    folder = write_subject(tmp_path / "person")
    file = folder / "subject.toml"
    file.write_text(file.read_text().replace('name = "walk_b"', 'name = "walk_b"\ncondition = "brace"'))
    subject, names = load_conditions(folder, "brace")
    assert names == ("no condition", "brace")
    assert subject.trials.conditions == ("no condition", "no condition", "brace")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('side = "l"', 'side = "r"', "[subject] side"),
        ("RecFem = ", "Rectus = ", "[emg.channels]"),
        ("mass_kg = 70.0", "mass_kg = 80.0", "[subject] mass_kg"),
        ('"hip_flexion_l", "knee', '"knee', "[model] coordinates"),
    ],
)
def test_folders_of_different_people_are_refused(tmp_path, old, new, words):
    first, second = write_subject(tmp_path / "brace"), write_subject(tmp_path / "plain")
    file = second / "subject.toml"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(InputError) as caught:
        load_conditions(first, second)
    assert words in str(caught.value) and str(file) in str(caught.value)


def test_another_model_is_refused(tmp_path):
    first, second = write_subject(tmp_path / "brace"), write_subject(tmp_path / "plain")
    model = second / "model.osim"
    model.write_text(model.read_text().replace("1500", "1501"))
    with pytest.raises(InputError, match="conditions share the person's model"):
        load_conditions(first, second)


def test_an_unknown_condition_is_named_with_the_nearest(tmp_path):
    folder = write_subject(tmp_path / "person")
    file = folder / "subject.toml"
    file.write_text(file.read_text().replace('name = "walk_b"', 'name = "walk_b"\ncondition = "brace"'))
    with pytest.raises(InputError, match="did you mean 'brace'"):
        load_conditions(folder, "brase")
