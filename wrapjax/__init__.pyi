# The public names, listed once: `wrapjax/__init__.py` imports each on first use.

from .calibration.calibration import Calibration as Calibration
from .calibration.calibration import calibrate as calibrate
from .calibration.initialisation import Initialisation as Initialisation
from .calibration.initialisation import initialise as initialise
from .calibration.problem import build_objective as build_objective
from .calibration.problem import objective as objective
from .calibration.uncertainty.uncertainty import Uncertainty as Uncertainty
from .calibration.uncertainty.uncertainty import uncertainty as uncertainty
from .cohorts.cohort import Cohort as Cohort
from .cohorts.cohort import cohort as cohort
from .comparison.comparison import Comparison as Comparison
from .comparison.comparison import compare as compare
from .contact_forces.contact_force import Contact as Contact
from .contact_forces.contact_force import contact as contact
from .datasets.public_recordings import fetch as fetch
from .diagnosis.against import ConditionDifference as ConditionDifference
from .diagnosis.against import diagnose_against as diagnose_against
from .diagnosis.diagnosis import Diagnosis as Diagnosis
from .diagnosis.diagnosis import diagnose as diagnose
from .diagnosis.effects.catalogue import effect_meanings as effect_meanings
from .errors import InputError as InputError
from .evaluation.evaluation import Evaluation as Evaluation
from .evaluation.evaluation import evaluate as evaluate
from .evaluation.stored_run import Run as Run
from .evaluation.stored_run import load_run as load_run
from .geometry.physiological import PhysiologicalThresholds as PhysiologicalThresholds
from .path_sources.exact import ExactGeometry as ExactGeometry
from .path_sources.exact import exact_geometry as exact_geometry
from .path_sources.path_fitting import fit as fit
from .path_sources.path_samples import physiological_picture as physiological_picture
from .path_sources.polynomial_fit import Fit as Fit
from .path_sources.polynomial_fit import load_fit as load_fit
from .path_sources.wrap_fitting import fit_wraps as fit_wraps
from .preprocessing.preparation import Preparation as Preparation
from .preprocessing.preparation import prepare_subject as prepare_subject
from .subject.conditions import load_conditions as load_conditions
from .subject.subject import load_subject as load_subject

__version__: str
