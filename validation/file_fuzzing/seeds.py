"""Valid files for fuzzing: inputs of the tests, and results that the commands write of them."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.subject.synthetic import MODEL, SETTINGS, write_subject

TABLE = b"""signals
version=1
nRows=4
nColumns=3
inDegrees=no
endheader
time\ta\tb
0.0\t1.5\t-2e-3
0.01\t1.25\t3
0.02\t1.0\t4.5
0.03\t.5\t5
"""
OLD_TABLE = b"""Coordinates
datacolumns 3
datarows 3
Angles are in degrees.
endheader

time  /jointset/hip/hip_flexion_l/value  knee_angle_l
 0.0   10.0   20.0
 0.5   11.0   21.0
 1.0   12.0   22.0
"""
MUSCLE_PARAMETERS = b"""\
muscle,note,max_isometric_force_N,optimal_fiber_length_m,tendon_slack_length_m,pennation_rad
recfem_l,scaled,1500.0,0.1,0.3,0.1
semiten_l,"a, b",900,0.15,0.25,0
"""
OLD_MODEL = b"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="30000"><Model name="old">
<defaults><Thelen2003Muscle name="default"><optimal_fiber_length>0.1</optimal_fiber_length>
<pennation_angle>0.2</pennation_angle></Thelen2003Muscle></defaults>
<BodySet><objects><Body name="tibia"><Joint><CustomJoint name="knee"><CoordinateSet><objects>
<Coordinate name="knee_angle_l"><range>-2 0.1</range><default_value>0</default_value></Coordinate>
</objects></CoordinateSet><SpatialTransform>
<TransformAxis name="rotation1"><coordinates>knee_angle_l</coordinates>
<function><LinearFunction><coefficients>1 0</coefficients></LinearFunction></function></TransformAxis>
</SpatialTransform></CustomJoint></Joint></Body></objects></BodySet>
<ForceSet><objects><Thelen2003Muscle name="vasti_l"><max_isometric_force>2000</max_isometric_force>
<tendon_slack_length>0.2</tendon_slack_length></Thelen2003Muscle></objects></ForceSet>
</Model></OpenSimDocument>
"""
BONE = b"""<?xml version="1.0"?>
<VTKFile type="PolyData" version="0.1"><PolyData><Piece NumberOfPoints="4" NumberOfPolys="2">
<Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">
0 0 0 1 0 0 1 1 0 0 1e-1 0</DataArray></Points>
<Polys><DataArray type="Int32" Name="connectivity" format="ascii">0 1 2 3 0 1 2</DataArray>
<DataArray type="Int32" Name="offsets" format="ascii">4 7</DataArray></Polys>
</Piece></PolyData></VTKFile>
"""
EXTERNAL_LOADS = b"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000"><ExternalLoads name="loads"><objects>
<ExternalForce name="left"><applied_to_body>/bodyset/calcn_l</applied_to_body>
<force_expressed_in_body>ground</force_expressed_in_body>
<point_expressed_in_body>ground</point_expressed_in_body>
<force_identifier>left_v</force_identifier><point_identifier>left_p</point_identifier>
<torque_identifier>left_t</torque_identifier></ExternalForce>
</objects><datafile>forces.mot</datafile></ExternalLoads></OpenSimDocument>
"""
OSIMX = b"""<?xml version="1.0" encoding="utf-8"?>
<NMSMPipelineDocument Version="1.5.0"><OsimxModel name="model">
<associated_osim_model>model.osim</associated_osim_model><RCNLMuscleSet><objects>
<RCNLMuscle name="recfem_l"><electromechanical_delay>0.5</electromechanical_delay>
<activation_time_constant>1.5</activation_time_constant><emg_scale_factor>0.7</emg_scale_factor>
<optimal_fiber_length>0.11</optimal_fiber_length></RCNLMuscle>
<RCNLMuscle name="semiten_l"><tendon_slack_length>0.2</tendon_slack_length></RCNLMuscle>
</objects></RCNLMuscleSet></OsimxModel></NMSMPipelineDocument>
"""
PROJECT = b"""<?xml version="1.0" encoding="UTF-8"?>
<NMSMPipelineDocument Version="1.5.0"><MuscleTendonPersonalizationTool>
<input_model_file>model.osim</input_model_file><input_osimx_file>muscles.osimx</input_osimx_file>
<data_directory>data</data_directory><coordinate_list>hip_flexion_l knee_angle_l</coordinate_list>
<collected_emg_channel_muscle_groups>ThighActivationGroupL</collected_emg_channel_muscle_groups>
<missing_emg_channel_muscle_groups/><trial_prefixes>walk</trial_prefixes>
</MuscleTendonPersonalizationTool></NMSMPipelineDocument>
"""
LABORATORY = b"""[subject]
name = "P07"
mass_kg = 80.5
side = "l"
paretic = true
[model]
file = "model.osim"
coordinates = ["hip_flexion_l", "knee_angle_l"]
[laboratory]
forward = "x"
up = "z"
[markers]
ignore = ["LASI2"]
weights = { LHEE = 10.0 }
[forces.l]
body = "calcn_l"
force = "left_v"
point = "left_p"
[forces.r]
body = "calcn_r"
plates = [2]
[emg]
unit = "mV"
gain = 1000
accept = ["Sol"]
[emg.channels]
Sol = ["soleus_l"]
[[trial]]
name = "walk_1"
use = "calibration"
markers = "walk.trc"
forces = "walk.mot"
emg = "walk.sto"
speed_m_s = 0.8
cycles = [[1.43, 2.79]]
"""
JOINT_SETTINGS = b"""[subject]
name = "P07"
[model]
file = "model.osim"
[laboratory]
forward = "x"
up = "z"
[markers]
ignore = ["LASI2"]
weights = { LHEE = 10.0 }
[joints]
free = ["hip_l", "knee_l"]
scales = "axes"
markers = false
symmetric = true
skin_movement_mm = 4.5
prior_factor = 2
frames = 50
[[trial]]
name = "walk_1"
use = "validation"
markers = "walk.trc"
weight = 2.0
interval = [0.5, 2]
[[trial]]
name = "walk_2"
markers = "walk.trc"
"""
JOINT_TASKS = b"""<?xml version="1.0" encoding="UTF-8"?>
<NMSMPipelineDocument Version="1.5.0"><JointModelPersonalizationTool>
<input_directory>.</input_directory><input_model_file>model.osim</input_model_file>
<JMPTaskList><JMPTask name="knee"><is_enabled>true</is_enabled><index>1</index>
<marker_file_name>.\\walk.trc</marker_file_name><time_range>0 0.5</time_range>
<marker_names>TH0_r SH1_r</marker_names><free_markers>TH1_r</free_markers>
<JMPJointSet><JMPJoint name="knee_r"><parent_frame_transformation>
<translation>false false true</translation><translation_bounds>0.05</translation_bounds>
<orientation>true true false</orientation><orientation_bounds>0.3</orientation_bounds>
</parent_frame_transformation></JMPJoint></JMPJointSet>
<JMPBodySet><JMPBody name="shank_r"><scale_body>true</scale_body>
<move_markers>true false false</move_markers></JMPBody></JMPBodySet>
</JMPTask></JMPTaskList></JointModelPersonalizationTool></NMSMPipelineDocument>
"""
JOINTS = b"""{"schema": 1, "joints": {"hip_l": {"coordinates": ["hip_flexion_l"],
"spread": {"translation_m": [0.002, 0.003, null], "orientation_rad": [null, null, null]}},
"knee_l": {"coordinates": ["knee_angle_l"],
"spread": {"translation_m": [0.001, 0.001, 0.007], "orientation_rad": [0.01, 0.02, null]}}}}
"""
MARKERS = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100\t100\t12\t2\tmm\t100\t1\t12\nFrame#\tTime\tP:HEAD\t\t\tHEEL\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
    + "".join(
        f"{order}\t{order / 100}\t{order}\t1700\t5"
        + ("\t\t\t\n" if order == 5 else f"\t{2 * order}\t20\t8\t\n")
        for order in range(1, 13)
    )
).encode()
SUBJECT_SETTINGS = (SETTINGS + 'ground_forces = "forces.mot"\nexternal_loads = "loads.xml"\n').encode()
WITH_TABLE = SETTINGS.replace('"model.osim"', '"model.osim"\nmuscle_parameters = "muscles.csv"').encode()
PLAIN_MODEL = MODEL.encode()
FORCES = "forces\nnRows=2\nnColumns=7\ninDegrees=no\nendheader\ntime\t" + "\t".join(
    f"left_{kind}{axis}" for kind in "vp" for axis in "xyz"
)


def small_subject(place: Path) -> Path:
    """Write a subject of two muscles and three cycles, with all optional files."""
    write_subject(place)
    (place / "loads.xml").write_bytes(EXTERNAL_LOADS)
    (place / "forces.mot").write_text(f"{FORCES}\tleft_tx\tleft_ty\tleft_tz\n0{' 1' * 9}\n4{' 1' * 9}\n")
    (place / "muscles.csv").write_bytes(MUSCLE_PARAMETERS)
    return place


def nmsm_project(place: Path) -> Path:
    """Write a project of the NMSM Pipeline with its files."""
    place.mkdir(parents=True)
    (place / "model.osim").write_bytes(PLAIN_MODEL)
    (place / "muscles.osimx").write_bytes(OSIMX)
    frames = "".join(f"{frame / 100}\t1\t2\n" for frame in range(121))
    for folder, kind in (("IKData", "_ik"), ("IDData", "_id"), ("EMGData", "_emg")):
        (place / "data" / folder).mkdir(parents=True)
        table = f"a\nnRows=121\nnColumns=3\ninDegrees=no\nendheader\ntime\ta\tb\n{frames}"
        (place / "data" / folder / f"walk{kind}.sto").write_text(table)
    return place


def laboratory(place: Path) -> Path:
    """Write placeholder files with the names in the laboratory settings."""
    place.mkdir(parents=True)
    for name in ("model.osim", "walk.trc", "walk.mot", "walk.sto"):
        (place / name).write_text("here")
    return place


def finished_results(place: Path) -> Path:
    """Run fit, calibration, evaluation and cohort of the small subject; keep the checkpoints, too."""
    from wrapjax.calibration.calibration import calibrate
    from wrapjax.cohorts.cohort import cohort
    from wrapjax.evaluation.evaluation import evaluate
    from wrapjax.evaluation.stored_run import load_run
    from wrapjax.jax_setup import set_up_jax
    from wrapjax.path_sources.path_fitting import fit
    from wrapjax.subject.subject import load_subject as load_subject

    set_up_jax()
    subject = load_subject(write_subject(place / "subject"))
    paths = fit(subject, processes=1)
    paths.save(place / "fit", subject=subject)
    done = calibrate(subject, "NGA", paths, starts=1, checkpoints=place / "book")
    shutil.copytree(place / "book", place / "journal")
    done.save(place / "run")
    evaluate(load_run(place / "run"), subject).save(place / "evaluation")
    cohort([place / "subject"], place / "cohort", starts=1, workers=1)
    return place
