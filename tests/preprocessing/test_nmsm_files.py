"""Reading and writing of ``.osimx`` files in the units of the NMSM Pipeline."""

import xml.etree.ElementTree as ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrapjax.errors import InputError
from wrapjax.preprocessing.nmsm.files import OSIMX_QUANTITIES, OsimxMuscle, format_osimx, read_osimx

VALUES = st.dictionaries(st.sampled_from(list(OSIMX_QUANTITIES)), st.floats(1e-4, 1e4))


@given(values=st.lists(VALUES, min_size=1, max_size=4))
def test_round_trip(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("osimx") / "model.osimx"
    muscles = tuple(OsimxMuscle(f"muscle_{number}_l", own) for number, own in enumerate(values))
    path.write_text(format_osimx("model", "model.osim", muscles), encoding="utf-8")
    again = read_osimx(path)
    assert [muscle.name for muscle in again] == [muscle.name for muscle in muscles]
    for one, other in zip(again, muscles, strict=True):
        assert one.values == pytest.approx(dict(other.values), rel=1e-14)


def test_units_of_delays_and_time_constants():
    """In the files 0.5 means a delay of 50 ms, and 1.5 a time constant of 15 ms."""
    muscle = OsimxMuscle("soleus_l", {"electromechanical_delay": 0.05, "activation_time_constant": 0.015})
    root = ElementTree.fromstring(format_osimx("m", "model.osim", [muscle]).split("\n", 1)[1])
    element = root.find("OsimxModel/RCNLMuscleSet/objects/RCNLMuscle")
    assert float(element.findtext("electromechanical_delay")) == pytest.approx(0.5)
    assert float(element.findtext("activation_time_constant")) == pytest.approx(1.5)
    assert root.findtext("OsimxModel/associated_osim_model") == "model.osim"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<RCNLMuscle name="a"/><RCNLMuscle name="a"/>', "occurs a second time"),
        ("<RCNLMuscle/>", "has no name"),
        (
            '<RCNLMuscle name="a"><emg_scale_factor>much</emg_scale_factor></RCNLMuscle>',
            "expected a number, found 'much'",
        ),
        (
            '<RCNLMuscle name="a"><emg_scale_factor>nan</emg_scale_factor></RCNLMuscle>',
            "expected a number, found 'nan'",
        ),
        ("<RCNLMuscle", "well-formed"),
    ],
)
def test_faults_are_reported(tmp_path, text, message):
    path = tmp_path / "model.osimx"
    path.write_text(f"<NMSMPipelineDocument>{text}</NMSMPipelineDocument>", encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_osimx(path)
