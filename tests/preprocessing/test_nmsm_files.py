"""Files of muscle parameters: what is written is read again, in the units of the NMSM Pipeline's code."""

import xml.etree.ElementTree as ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrapjax.errors import InputError
from wrapjax.preprocessing.nmsm_files import OSIMX_QUANTITIES, OsimxMuscle, format_osimx, read_osimx

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


def test_delays_count_tenths_of_a_second_and_time_constants_hundredths():
    """As facts about its files: 0.5 stands for 50 ms, 1.5 for 15 ms."""
    muscle = OsimxMuscle("soleus_l", {"electromechanical_delay": 0.05, "activation_time_constant": 0.015})
    root = ElementTree.fromstring(format_osimx("m", "model.osim", [muscle]).split("\n", 1)[1])
    element = root.find("OsimxModel/RCNLMuscleSet/objects/RCNLMuscle")
    assert float(element.findtext("electromechanical_delay")) == pytest.approx(0.5)
    assert float(element.findtext("activation_time_constant")) == pytest.approx(1.5)
    assert root.findtext("OsimxModel/associated_osim_model") == "model.osim"


@pytest.mark.parametrize(
    ("text", "said"),
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
def test_what_is_wrong_is_said(tmp_path, text, said):
    path = tmp_path / "model.osimx"
    path.write_text(f"<NMSMPipelineDocument>{text}</NMSMPipelineDocument>", encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_osimx(path)
