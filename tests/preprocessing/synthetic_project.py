"""Synthetic project of the NMSM Pipeline with the signals of the synthetic subject."""

import numpy as np

from tests.subject.synthetic import CHANNELS, COORDINATES, MODEL, PERIOD, angles, emg, moments
from wrapjax.io.storage import Storage, write_storage

#: Number of additional frames before and after each cycle.
ADDITIONAL_FRAMES = 20
STARTS = {"gait_1": 0.5, "gait_2": 1.9}
SETTINGS = """<?xml version="1.0" encoding="utf-8"?>
<NMSMPipelineDocument Version="1.5.0">
 <MuscleTendonPersonalizationTool>
  <results_directory>results</results_directory>
  <input_model_file>models\\model.osim</input_model_file>
  <input_osimx_file>{osimx}</input_osimx_file>
  <data_directory>preprocessed</data_directory>
  <coordinate_list>{coordinates}</coordinate_list>
  <collected_emg_channel_muscle_groups>{groups}</collected_emg_channel_muscle_groups>
  <missing_emg_channel_muscle_groups>{missing}</missing_emg_channel_muscle_groups>
  <trial_prefixes>{prefixes}</trial_prefixes>
  {others}
 </MuscleTendonPersonalizationTool>
</NMSMPipelineDocument>
"""
OSIMX = """<NMSMPipelineDocument Version="1.5.0"><OsimxModel name="m"><RCNLMuscleSet><objects>
<RCNLMuscle name="semiten_l"><electromechanical_delay>0.5</electromechanical_delay>
<optimal_fiber_length>0.17</optimal_fiber_length></RCNLMuscle>
</objects></RCNLMuscleSet></OsimxModel></NMSMPipelineDocument>
"""


def with_groups(model: str) -> str:
    own = "".join(
        f'<ObjectGroup name="{channel}"><members> {" ".join(muscles)}</members></ObjectGroup>'
        for channel, muscles in CHANNELS.items()
    )
    return model.replace("</groups>", own + "</groups>")


def write_settings(folder, **changes):
    values = {
        "osimx": "",
        "coordinates": " ".join(COORDINATES),
        "groups": " ".join(CHANNELS),
        "missing": "",
        "prefixes": "",
        "others": "",
        **changes,
    }
    (folder / "settings.xml").write_text(SETTINGS.format(**values), encoding="utf-8")
    return folder / "settings.xml"


def write_project(folder):
    """Write the model, two trials with additional frames, and muscle parameters of an earlier step."""
    (folder / "models").mkdir()
    (folder / "models" / "model.osim").write_text(with_groups(MODEL), encoding="utf-8")
    (folder / "earlier.osimx").write_text(OSIMX, encoding="utf-8")
    step = PERIOD / 100
    for name, start in STARTS.items():
        time = start + step * np.arange(-ADDITIONAL_FRAMES, 101 + ADDITIONAL_FRAMES)
        data = folder / "preprocessed"
        write_storage(data / "IKData" / f"{name}.sto", Storage("ik", COORDINATES, time, angles(time).T))
        write_storage(data / "IDData" / f"{name}.sto", Storage("id", COORDINATES, time, moments(time).T))
        write_storage(data / "EMGData" / f"{name}.sto", Storage("emg", tuple(CHANNELS), time, emg(time).T))
    return folder
