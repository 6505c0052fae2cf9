"""Tests of scaling a generic model to a subject by OpenSim's scale tool."""

import numpy as np
import opensim
import pytest

from tests.preprocessing.walker import build_walker, write_trc
from wrapjax.errors import InputError
from wrapjax.osim.tools import scale_model

SIZE = 1.1
PAIRS = {"pelvis": "P0 P3", "femur_l": "LT0 LT1", "tibia_l": "LS0 LS1", "calcn_l": "LF0 LF1"}
PAIRS |= {name[:-1] + "r": pair.replace("L", "R") for name, pair in PAIRS.items() if name.endswith("_l")}


def measurement(body, pair):
    return f"""<Measurement name="{body}"><apply>true</apply>
<MarkerPairSet><objects><MarkerPair><markers>{pair}</markers></MarkerPair></objects></MarkerPairSet>
<BodyScaleSet><objects><BodyScale name="{body}"><axes>X Y Z</axes></BodyScale></objects></BodyScaleSet>
</Measurement>"""


SETUP = f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000"><ScaleTool name="person"><mass>1</mass>
<GenericModelMaker><model_file>elsewhere.osim</model_file></GenericModelMaker>
<ModelScaler><apply>true</apply><scaling_order>measurements</scaling_order>
<MeasurementSet><objects>{"".join(measurement(*entry) for entry in PAIRS.items())}</objects></MeasurementSet>
<marker_file>static.trc</marker_file><time_range>0 0.5</time_range>
<preserve_mass_distribution>true</preserve_mass_distribution></ModelScaler>
<MarkerPlacer><apply>false</apply></MarkerPlacer>
</ScaleTool></OpenSimDocument>"""
TASKS = "".join(
    f'<IKMarkerTask name="{name}"><apply>true</apply><weight>1</weight></IKMarkerTask>'
    for name in " ".join(PAIRS.values()).split()
)
PLACED = SETUP.replace(
    "<MarkerPlacer><apply>false</apply>",
    f"<MarkerPlacer><apply>true</apply><IKTaskSet><objects>{TASKS}</objects></IKTaskSet>"
    "<marker_file>static.trc</marker_file><time_range>0 0.5</time_range>",
)


@pytest.fixture
def laboratory(tmp_path):
    """Folder with a generic model, settings, and a static trial of a subject that is a tenth larger."""
    model = build_walker()
    model.printToXML(str(tmp_path / "generic.osim"))
    state = model.initSystem()
    markers = [model.getMarkerSet().get(index) for index in range(model.getMarkerSet().getSize())]
    place = np.array([marker.getLocationInGround(state).to_numpy() for marker in markers])
    still = np.repeat(SIZE * place[:, None], 60, axis=1)
    write_trc(tmp_path / "static.trc", np.arange(60) / 100.0, [m.getName() for m in markers], still)
    (tmp_path / "setup.xml").write_text(SETUP, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("setup", [SETUP, PLACED], ids=["scaled", "markers placed"])
def test_segments_and_mass_are_those_of_the_subject(laboratory, capfd, setup):
    (laboratory / "setup.xml").write_text(setup, encoding="utf-8")
    scaled = laboratory / "out" / "scaled.osim"
    scaled.parent.mkdir()
    before = sorted(laboratory.iterdir())
    scale_model(laboratory / "generic.osim", laboratory / "setup.xml", 80.0, scaled)
    assert sorted(laboratory.iterdir()) == before  # the tool's own files are removed
    assert capfd.readouterr().out == ""
    model = opensim.Model(str(scaled))
    state = model.initSystem()
    assert model.getTotalMass(state) == pytest.approx(80.0, rel=1e-6)
    hip, knee = (
        model.getBodySet().get(name).getPositionInGround(state).to_numpy() for name in ("femur_l", "tibia_l")
    )
    assert np.linalg.norm(hip - knee) == pytest.approx(SIZE * 0.42, rel=1e-3)


def test_settings_without_measurements_are_an_error(laboratory):
    (laboratory / "setup.xml").write_text('<OpenSimDocument Version="40000"><ScaleTool/></OpenSimDocument>')
    with pytest.raises(InputError, match=r"setup\.xml.*measurements, found none"):
        scale_model(laboratory / "generic.osim", laboratory / "setup.xml", 80.0, laboratory / "scaled.osim")


def test_a_missing_static_trial_is_an_error(laboratory):
    (laboratory / "static.trc").unlink()
    with pytest.raises(InputError, match=r"marker_file.*found no .*static\.trc"):
        scale_model(laboratory / "generic.osim", laboratory / "setup.xml", 80.0, laboratory / "scaled.osim")
