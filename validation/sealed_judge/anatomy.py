"""Generic right leg: segments, joints, muscle paths and muscle constants.

Coordinates in metres in the frames of the gait2392 model (Delp et al. 1990, doi:10.1109/10.102791): x
forward, y up, z to the right.  Moving and conditional points of that model are replaced by cylinders.
"""

from __future__ import annotations

import numpy as np

BODIES = ("pelvis", "femur", "tibia", "talus", "calcn")
PELVIS, FEMUR, TIBIA, TALUS, CALCN = range(5)

#: Generalised coordinates of the leg, in the order used by every array of this package.
COORDS = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle", "subtalar_angle")
#: Generalised coordinates of the pelvis.
PELVIS_COORDS = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
#: Indices in COORDS of the coordinates whose moments the lab gives to an EMG-driven model.
USED = (0, 1, 3, 4, 5)

#: Origin of each joint in its parent body.
JOINTS = {
    "hip": (-0.0707, -0.0661, 0.0835),
    "knee": (0.0, -0.396, 0.0),
    "ankle": (0.0, -0.43, 0.0),
    "subtalar": (-0.04877, -0.04195, 0.00792),
}
#: Axes in the parent body; the three hip rotations are z, x, y in body-fixed order.  Knee flexion is positive
#: about -z; a person may use the opposite sign (see ``Leg.knee_sign``).
AXES = {
    "knee": (0.0, 0.0, -1.0),
    "ankle": (-0.10501355, -0.17402245, 0.97912632),
    "subtalar": (0.78717961, 0.60474746, -0.12094949),
}

#: Mass (kg), centre of mass (m) and principal inertia (kg m2) of each segment for a body mass of 75.16 kg.
GENERIC_MASS = 75.16
SEGMENTS = {
    "pelvis": (11.777, (-0.0707, 0.0, 0.0), (0.1028, 0.0871, 0.0579)),
    "femur": (9.3014, (0.0, -0.17, 0.0), (0.1339, 0.0351, 0.1412)),
    "tibia": (3.7075, (0.0, -0.1867, 0.0), (0.0504, 0.0051, 0.0511)),
    "talus": (0.1, (0.0, 0.0, 0.0), (0.001, 0.001, 0.001)),
    "calcn": (1.4666, (0.11, 0.025, 0.0), (0.0016, 0.0048, 0.0050)),
}

#: Cylinders with axis along z: body, centre, radius, side on which the path passes (+1: +x, -1: -x).
CYLINDERS = {
    "hip_front": (PELVIS, (-0.0707, -0.0661, 0.0835), 0.032, 1),
    "knee_front": (FEMUR, (-0.002, -0.398, 0.0), 0.041, 1),
    "knee_back": (FEMUR, (0.002, -0.398, 0.0), 0.021, -1),
    "ankle_front": (TIBIA, (0.0, -0.425, 0.0), 0.033, 1),
}

P, F, T, C = PELVIS, FEMUR, TIBIA, CALCN
#: Muscle: maximum isometric force (N), optimal fiber length (m), pennation (degrees), normalised fiber length
#: at the mean posture of walking (Arnold and Delp 2011, doi:10.1098/rstb.2010.0345, rounded), path points
#: (body, x, y, z), and the cylinder with the index of the point before it.
MUSCLES: dict[str, tuple] = {
    "glut_med1": (819, 0.0535, 8, 0.90, ((P, -0.0408, 0.0304, 0.1209), (F, -0.0218, -0.0117, 0.0555)), None),
    "glut_med2": (573, 0.0845, 0, 0.90, ((P, -0.0855, 0.0445, 0.0766), (F, -0.0258, -0.0058, 0.0527)), None),
    "glut_med3": (653, 0.0646, 19, 0.88, ((P, -0.1223, 0.0105, 0.0648), (F, -0.0309, -0.0047, 0.0518)), None),
    "glut_min1": (270, 0.068, 10, 0.95, ((P, -0.0467, -0.0080, 0.1056), (F, -0.0072, -0.0104, 0.0560)), None),
    "glut_min2": (285, 0.0560, 0, 0.95, ((P, -0.0633, -0.0065, 0.0991), (F, -0.0096, -0.0104, 0.0560)), None),
    "glut_min3": (323, 0.0480, 1, 0.95, ((P, -0.0834, -0.0063, 0.0856), (F, -0.0135, -0.0083, 0.0550)), None),
    "glut_max1": (
        573, 0.142, 5, 0.88,
        ((P, -0.1195, 0.0612, 0.0700), (P, -0.1291, 0.0012, 0.0886), (F, -0.0457, -0.0248, 0.0392),
         (F, -0.0277, -0.0566, 0.0470)), None,
    ),
    "glut_max2": (
        819, 0.147, 0, 0.88,
        ((P, -0.1349, 0.0176, 0.0563), (P, -0.1376, -0.0520, 0.0914), (F, -0.0426, -0.0530, 0.0293),
         (F, -0.0156, -0.1016, 0.0419)), None,
    ),
    "glut_max3": (
        552, 0.144, 5, 0.85,
        ((P, -0.1556, -0.0314, 0.0058), (P, -0.1529, -0.1052, 0.0403), (F, -0.0299, -0.1041, 0.0135),
         (F, -0.0060, -0.1419, 0.0411)), None,
    ),
    "add_long": (627, 0.138, 6, 0.95, ((P, -0.0316, -0.0836, 0.0169), (F, 0.0050, -0.2111, 0.0234)), None),
    "add_brev": (429, 0.133, 0, 0.90, ((P, -0.0587, -0.0915, 0.0164), (F, 0.0009, -0.1196, 0.0294)), None),
    "add_mag1": (381, 0.087, 5, 0.95, ((P, -0.0732, -0.1174, 0.0255), (F, -0.0045, -0.1211, 0.0339)), None),
    "add_mag2": (343, 0.121, 3, 0.95, ((P, -0.0831, -0.1192, 0.0308), (F, 0.0054, -0.2285, 0.0227)), None),
    "add_mag3": (488, 0.131, 5, 1.0, ((P, -0.0771, -0.1181, 0.0276), (F, 0.0070, -0.3837, -0.0266)), None),
    "iliacus": (
        1073, 0.100, 7, 0.95, ((P, -0.0500, 0.0000, 0.0854), (F, -0.0193, -0.0621, 0.0129)), ("hip_front", 0)
    ),
    "psoas": (
        1113, 0.100, 8, 0.95, ((P, -0.0480, 0.0350, 0.0450), (F, -0.0188, -0.0597, 0.0104)), ("hip_front", 0)
    ),
    "pect": (266, 0.100, 0, 0.80, ((P, -0.0431, -0.0768, 0.0451), (F, -0.0122, -0.0822, 0.0253)), None),
    "sartorius": (
        156, 0.520, 0, 0.80,
        ((P, -0.0153, -0.0013, 0.1242), (F, -0.0030, -0.3568, -0.0421), (T, -0.0056, -0.0419, -0.0399),
         (T, 0.0060, -0.0589, -0.0383), (T, 0.0243, -0.0840, -0.0252)), None,
    ),
    "tfl": (
        233, 0.095, 3, 1.0,
        ((P, -0.0311, 0.0214, 0.1241), (F, 0.0294, -0.0995, 0.0597), (F, 0.0054, -0.3800, 0.0400),
         (T, 0.0060, -0.0487, 0.0297)), None,
    ),
    "rect_fem": (
        1169, 0.114, 5, 0.88, ((P, -0.0295, -0.0311, 0.0968), (T, 0.0400, -0.0750, 0.001)), ("knee_front", 0)
    ),
    "vas_med": (
        1294, 0.089, 5, 0.80,
        ((F, 0.0140, -0.2099, 0.0188), (F, 0.0356, -0.2769, 0.0009), (T, 0.0400, -0.0750, -0.003)),
        ("knee_front", 1),
    ),
    "vas_int": (
        1365, 0.087, 3, 0.80,
        ((F, 0.0290, -0.1924, 0.0310), (F, 0.0335, -0.2084, 0.0285), (T, 0.0400, -0.0750, 0.001)),
        ("knee_front", 1),
    ),
    "vas_lat": (
        1871, 0.084, 5, 0.78,
        ((F, 0.0048, -0.1854, 0.0349), (F, 0.0269, -0.2591, 0.0409), (T, 0.0400, -0.0750, 0.003)),
        ("knee_front", 1),
    ),
    "semimem": (1288, 0.080, 15, 0.85, ((P, -0.1192, -0.1015, 0.0695), (T, -0.0243, -0.0536, -0.0194)), None),
    "semiten": (
        410, 0.201, 5, 0.92,
        ((P, -0.1258, -0.1110, 0.0603), (T, -0.0314, -0.0545, -0.0146), (T, -0.0113, -0.0746, -0.0245),
         (T, 0.0027, -0.0956, -0.0193)), None,
    ),
    "bifemlh": (
        896, 0.109, 0, 0.85,
        ((P, -0.1244, -0.1001, 0.0666), (T, -0.0301, -0.0360, 0.0294), (T, -0.0234, -0.0563, 0.0343)), None,
    ),
    "bifemsh": (
        804, 0.173, 23, 0.85,
        ((F, 0.0050, -0.2111, 0.0234), (T, -0.0301, -0.0360, 0.0294), (T, -0.0234, -0.0563, 0.0343)), None,
    ),
    "med_gas": (
        1558, 0.060, 17, 0.90, ((F, -0.0120, -0.3740, -0.0235), (C, 0.0044, 0.0310, -0.0053)),
        ("knee_back", 0),
    ),
    "lat_gas": (
        683, 0.064, 8, 0.90, ((F, -0.0130, -0.3740, 0.0272), (C, 0.0044, 0.0310, -0.0053)), ("knee_back", 0)
    ),
    "soleus": (3549, 0.050, 25, 0.92, ((T, -0.0024, -0.1533, 0.0071), (C, 0.0044, 0.0310, -0.0053)), None),
    "tib_post": (
        1588, 0.035, 12, 0.95,
        ((T, -0.0094, -0.1348, 0.0019), (T, -0.0144, -0.4051, -0.0229), (C, 0.0417, 0.0334, -0.0286),
         (C, 0.0772, 0.0159, -0.0281)), None,
    ),
    "flex_hal": (
        322, 0.043, 10, 0.90,
        ((T, -0.0079, -0.2334, 0.0244), (T, -0.0186, -0.4079, -0.0174), (C, 0.0374, 0.0276, -0.0241),
         (C, 0.1038, 0.0068, -0.0256)), None,
    ),
    "tib_ant": (
        905, 0.098, 5, 0.95,
        ((T, 0.0179, -0.1624, 0.0115), (T, 0.0329, -0.3951, -0.0177), (C, 0.1166, 0.0178, -0.0305)), None,
    ),
    "ext_dig": (
        512, 0.102, 8, 0.95, ((T, 0.0032, -0.1381, 0.0276), (C, 0.1100, 0.0300, 0.0030)), ("ankle_front", 0)
    ),
    "per_long": (
        943, 0.049, 10, 0.95,
        ((T, 0.0005, -0.1568, 0.0362), (T, -0.0207, -0.4205, 0.0286), (C, 0.0438, 0.0230, 0.0221),
         (C, 0.0681, 0.0106, 0.0284)), None,
    ),
    "per_brev": (
        435, 0.050, 5, 0.95,
        ((T, -0.0070, -0.2646, 0.0325), (T, -0.0198, -0.4184, 0.0283), (C, 0.0471, 0.0270, 0.0233),
         (C, 0.0677, 0.0219, 0.0343)), None,
    ),
}  # fmt: skip
NAMES = tuple(MUSCLES)

#: Electrode: the muscles that share its neural drive.  The muscles in SILENT have no electrode and
#: are silent in a person with nothing amiss.
CHANNELS: dict[str, tuple[str, ...]] = {
    "gluteus_maximus": ("glut_max1", "glut_max2", "glut_max3"),
    "gluteus_medius": ("glut_med1", "glut_med2", "glut_med3", "glut_min1", "glut_min2", "glut_min3"),
    "adductors": ("add_long", "add_brev", "add_mag1", "add_mag2", "add_mag3"),
    "iliopsoas": ("iliacus", "psoas"),
    "tensor_fasciae_latae": ("tfl",),
    "rectus_femoris": ("rect_fem",),
    "vastus_lateralis": ("vas_lat", "vas_int"),
    "vastus_medialis": ("vas_med",),
    "medial_hamstrings": ("semimem", "semiten"),
    "biceps_femoris": ("bifemlh", "bifemsh"),
    "gastrocnemius_medialis": ("med_gas",),
    "gastrocnemius_lateralis": ("lat_gas",),
    "soleus": ("soleus",),
    "tibialis_anterior": ("tib_ant",),
    "tibialis_posterior": ("tib_post",),
    "peroneus": ("per_long", "per_brev"),
    "extensor_digitorum": ("ext_dig",),
}
CHANNEL_NAMES = tuple(CHANNELS)
SILENT = ("pect", "sartorius", "flex_hal")


def channel_matrix() -> np.ndarray:
    """Return the 0/1 matrix that gives each muscle the drive of its electrode, shape (muscles, channels)."""
    out = np.zeros((len(NAMES), len(CHANNELS)))
    for j, members in enumerate(CHANNELS.values()):
        for name in members:
            out[NAMES.index(name), j] = 1.0
    return out
