"""What users call, in rooms by what they are about. The commands call only these."""

from wrapjax.api.calibrating.calibration import Calibration as Calibration
from wrapjax.api.calibrating.calibration import calibrate as calibrate
from wrapjax.api.calibrating.initialisation import Initialisation as Initialisation
from wrapjax.api.calibrating.initialisation import initialise as initialise
from wrapjax.api.calibrating.problem import objective as objective
from wrapjax.api.calibrating.problem import prepare as prepare
from wrapjax.api.calibrating.uncertainty import Uncertainty as Uncertainty
from wrapjax.api.calibrating.uncertainty import uncertainty as uncertainty
from wrapjax.api.cohorts.running import Cohort as Cohort
from wrapjax.api.cohorts.running import cohort as cohort
from wrapjax.api.comparing.comparison import Comparison as Comparison
from wrapjax.api.comparing.comparison import compare as compare
from wrapjax.api.diagnosing.diagnosis import Diagnosis as Diagnosis
from wrapjax.api.diagnosing.diagnosis import diagnose as diagnose
from wrapjax.api.fetching import fetch as fetch
from wrapjax.api.laboratory.prepared_subject import Preparation as Preparation
from wrapjax.api.laboratory.prepared_subject import prepare_subject as prepare_subject
from wrapjax.api.paths.exact import ExactGeometry as ExactGeometry
from wrapjax.api.paths.exact import exact_geometry as exact_geometry
from wrapjax.api.paths.fitting import Fit as Fit
from wrapjax.api.paths.fitting import fit as fit
from wrapjax.api.paths.fitting import load_fit as load_fit
from wrapjax.api.paths.wrap_fitting import fit_wraps as fit_wraps
from wrapjax.api.paths.wrap_pictures import physiological_picture as physiological_picture
from wrapjax.api.runs.contact_force import Contact as Contact
from wrapjax.api.runs.contact_force import contact as contact
from wrapjax.api.runs.evaluation import Evaluation as Evaluation
from wrapjax.api.runs.evaluation import evaluate as evaluate
from wrapjax.api.runs.stored_run import Run as Run
from wrapjax.api.runs.stored_run import load_run as load_run
from wrapjax.gap.catalogue import effect_meanings as effect_meanings
from wrapjax.geometry.physiological import PhysiologicalThresholds as PhysiologicalThresholds
from wrapjax.subject import read_subject as load_subject

__all__ = [
    "Calibration",
    "Cohort",
    "Comparison",
    "Contact",
    "Diagnosis",
    "Evaluation",
    "ExactGeometry",
    "Fit",
    "Initialisation",
    "PhysiologicalThresholds",
    "Preparation",
    "Run",
    "Uncertainty",
    "calibrate",
    "cohort",
    "compare",
    "contact",
    "diagnose",
    "effect_meanings",
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
