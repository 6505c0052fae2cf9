"""What users call: one module a verb. The commands call only these."""

from wrapjax.api.calibration import Calibration as Calibration
from wrapjax.api.calibration import calibrate as calibrate
from wrapjax.api.comparison import Comparison as Comparison
from wrapjax.api.comparison import compare as compare
from wrapjax.api.contact_force import Contact as Contact
from wrapjax.api.contact_force import contact as contact
from wrapjax.api.diagnosis import Diagnosis as Diagnosis
from wrapjax.api.diagnosis import diagnose as diagnose
from wrapjax.api.exact import ExactGeometry as ExactGeometry
from wrapjax.api.exact import exact_geometry as exact_geometry
from wrapjax.api.fitting import Fit as Fit
from wrapjax.api.fitting import fit as fit
from wrapjax.api.fitting import load_fit as load_fit
from wrapjax.api.preparation import objective as objective
from wrapjax.api.preparation import prepare as prepare
from wrapjax.api.preparing import Preparation as Preparation
from wrapjax.api.preparing import prepare_subject as prepare_subject
from wrapjax.api.wrap_fitting import fit_wraps as fit_wraps
from wrapjax.api.wrap_pictures import physiological_picture as physiological_picture
from wrapjax.subject import read_subject as load_subject

__all__ = [
    "Calibration",
    "Comparison",
    "Diagnosis",
    "ExactGeometry",
    "Fit",
    "Preparation",
    "calibrate",
    "compare",
    "diagnose",
    "exact_geometry",
    "fit",
    "fit_wraps",
    "load_fit",
    "load_subject",
    "objective",
    "physiological_picture",
    "prepare",
    "prepare_subject",
]
