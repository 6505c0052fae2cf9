"""Pairs of conditions of recorded people: alternate cycles, one of them with a known error."""

import tomllib
from functools import partial

import numpy as np
import pytest

from validation.diagnosis.condition_pairs import Judged
from validation.recorded import conditions
from validation.recorded.conditions import UNTOUCHED, table, write_pairs
from validation.recorded.manipulations import Manipulation, with_offset
from wrapjax.io.storage import read_storage

RAISED = Manipulation(
    "offset",
    "0.1 added",
    partial(with_offset, channel="soleus_l_activation", offset=0.1, slowest_only=False),
    "emg_offset",
)
HIDDEN = Manipulation("hidden", "no electrode", list, "missing_drive", hidden="soleus_l_activation")


@pytest.fixture(scope="module")
def pairs(data_folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("pairs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conditions, "manipulations_of", lambda *arguments: [RAISED, HIDDEN])
        written = write_pairs(data_folder / "healthy_treadmill", out, 2.0)
    assert written == [UNTOUCHED, RAISED], "an electrode of one condition alone is no comparison"
    return out


def cycles(folder):
    trials = tomllib.loads((folder / "subject.toml").read_text())["trial"]
    return {tuple(pair) for trial in trials if trial["use"] == "calibration" for pair in trial["cycles"]}


def test_conditions_have_alternate_cycles_and_one_model(pairs, data_folder):
    source = data_folder / "healthy_treadmill"
    place = pairs / "healthy_treadmill.offset"
    first, second = cycles(place / "with"), cycles(place / "without")
    assert not first & second and first | second == cycles(source)
    assert abs(len(first) - len(second)) <= 1
    for name in ("with", "without"):
        assert (place / name / "model.osim").read_bytes() == (source / "model.osim").read_bytes()


def test_the_error_is_in_one_condition_alone(pairs, data_folder):
    source, place = data_folder / "healthy_treadmill", pairs / "healthy_treadmill.offset"
    before, raised, same = (
        read_storage(folder / "trials" / "walk" / "emg.sto")
        for folder in (source, place / "with", place / "without")
    )
    column = before.columns.index("soleus_l_activation")
    np.testing.assert_allclose(raised.values[:, column], before.values[:, column] + 0.1, atol=1e-6)
    np.testing.assert_allclose(same.values, before.values, atol=1e-6)


def test_the_table_counts_right_effects_and_names_without_a_difference():
    found = {
        "one.untouched": Judged("", 0.0, "named", ("emg_drift with",), False, None, "emg_drift with"),
        "one.offset": Judged("emg_offset", 0.0, "named", ("emg_offset with",), True, 1, "emg_offset with"),
        "two.offset": Judged("emg_offset", 0.0, "none", (), False, 4, "emg_drift with"),
    }
    errors = {name: UNTOUCHED if "untouched" in name else RAISED for name in found}
    text = table(errors, found)
    assert "Right effect first, in the condition that has it: 1 of 2; right family first: 2." in text
    assert "Named or tied: 1, 1 of them with the right effect." in text
    assert "Nothing added: a name or tie in 1 of 1." in text
