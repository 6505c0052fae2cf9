"""What users call: one module a verb. The commands call only these."""

from wrapjax.api.calibration import Calibration as Calibration
from wrapjax.api.calibration import calibrate as calibrate
from wrapjax.api.cohorts import Cohort as Cohort
from wrapjax.api.cohorts import cohort as cohort
from wrapjax.api.comparison import Comparison as Comparison
from wrapjax.api.comparison import compare as compare
from wrapjax.api.contact_force import Contact as Contact
from wrapjax.api.contact_force import contact as contact
from wrapjax.api.diagnosis import Diagnosis as Diagnosis
from wrapjax.api.diagnosis import diagnose as diagnose
from wrapjax.api.evaluation import Evaluation as Evaluation
from wrapjax.api.evaluation import evaluate as evaluate
from wrapjax.api.exact import ExactGeometry as ExactGeometry
from wrapjax.api.exact import exact_geometry as exact_geometry
from wrapjax.api.fetching import fetch as fetch
from wrapjax.api.fitting import Fit as Fit
from wrapjax.api.fitting import fit as fit
from wrapjax.api.fitting import load_fit as load_fit
from wrapjax.api.initialisation import Initialisation as Initialisation
from wrapjax.api.initialisation import initialise as initialise
from wrapjax.api.preparation import objective as objective
from wrapjax.api.preparation import prepare as prepare
from wrapjax.api.preparing import Preparation as Preparation
from wrapjax.api.preparing import prepare_subject as prepare_subject
from wrapjax.api.stored_run import Run as Run
from wrapjax.api.stored_run import load_run as load_run
from wrapjax.api.uncertainty import Uncertainty as Uncertainty
from wrapjax.api.uncertainty import uncertainty as uncertainty
from wrapjax.api.wrap_fitting import fit_wraps as fit_wraps
from wrapjax.api.wrap_pictures import physiological_picture as physiological_picture
from wrapjax.subject import read_subject as load_subject

__all__ = [
    "Calibration",
    "Cohort",
    "Comparison",
    "Diagnosis",
    "Evaluation",
    "ExactGeometry",
    "Fit",
    "Initialisation",
    "Preparation",
    "Run",
    "Uncertainty",
    "calibrate",
    "cohort",
    "compare",
    "diagnose",
    "evaluate",
    "exact_geometry",
    "fetch",
    "fit",
    "fit_wraps",
    "initialise",
    "load_fit",
    "load_run",
    "load_subject",
    "objective",
    "physiological_picture",
    "prepare",
    "prepare_subject",
    "uncertainty",
]
