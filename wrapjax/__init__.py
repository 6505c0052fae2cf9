"""Calibrate EMG-driven musculoskeletal models with exact gradients.

``prepare_subject`` makes a subject folder of a laboratory's raw files, ``load_subject`` reads one,
``fit`` replaces its muscle paths by polynomials, ``fit_wraps`` learns how those follow the
cylinders that muscles wrap round, ``initialise`` finds lengths to start from, ``calibrate`` fits the model
to the person, ``compare`` does so by several methods and tests which differ, ``uncertainty`` says how well
the recordings determine what was found, ``diagnose`` what is left of the error and which effect explains it
best (of those that ``effect_meanings`` lists), ``contact`` says what joints bear, ``evaluate`` predicts
other cycles by a finished run (``load_run``), ``cohort`` calibrates many subjects side by side, ``fetch``
downloads public recordings, ``objective`` gives what is minimised as a pure function for `jax.grad`, and
``prepare`` all that is behind it.
All numbers are SI and radians; JAX must be in 64-bit mode::

    import jax
    jax.config.update("jax_enable_x64", True)
"""

import sys
from importlib import import_module
from importlib.metadata import version
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wrapjax.api import Calibration as Calibration
    from wrapjax.api import Cohort as Cohort
    from wrapjax.api import Comparison as Comparison
    from wrapjax.api import Contact as Contact
    from wrapjax.api import Diagnosis as Diagnosis
    from wrapjax.api import Evaluation as Evaluation
    from wrapjax.api import ExactGeometry as ExactGeometry
    from wrapjax.api import Fit as Fit
    from wrapjax.api import Initialisation as Initialisation
    from wrapjax.api import PhysiologicalThresholds as PhysiologicalThresholds
    from wrapjax.api import Preparation as Preparation
    from wrapjax.api import Run as Run
    from wrapjax.api import Uncertainty as Uncertainty
    from wrapjax.api import calibrate as calibrate
    from wrapjax.api import cohort as cohort
    from wrapjax.api import compare as compare
    from wrapjax.api import contact as contact
    from wrapjax.api import diagnose as diagnose
    from wrapjax.api import effect_meanings as effect_meanings
    from wrapjax.api import evaluate as evaluate
    from wrapjax.api import exact_geometry as exact_geometry
    from wrapjax.api import fetch as fetch
    from wrapjax.api import fit as fit
    from wrapjax.api import fit_wraps as fit_wraps
    from wrapjax.api import initialise as initialise
    from wrapjax.api import load_fit as load_fit
    from wrapjax.api import load_run as load_run
    from wrapjax.api import load_subject as load_subject
    from wrapjax.api import objective as objective
    from wrapjax.api import physiological_picture as physiological_picture
    from wrapjax.api import prepare as prepare
    from wrapjax.api import prepare_subject as prepare_subject
    from wrapjax.api import uncertainty as uncertainty
    from wrapjax.errors import InputError as InputError

__version__ = version("wrapjax")

# Imported on first use: the command line must be able to set thread counts before JAX is loaded.
_PLACES = {
    "Calibration": "wrapjax.api",
    "Cohort": "wrapjax.api",
    "Comparison": "wrapjax.api",
    "Contact": "wrapjax.api",
    "Diagnosis": "wrapjax.api",
    "Evaluation": "wrapjax.api",
    "ExactGeometry": "wrapjax.api",
    "Fit": "wrapjax.api",
    "Initialisation": "wrapjax.api",
    "InputError": "wrapjax.errors",
    "PhysiologicalThresholds": "wrapjax.api",
    "Preparation": "wrapjax.api",
    "Run": "wrapjax.api",
    "Uncertainty": "wrapjax.api",
    "calibrate": "wrapjax.api",
    "cohort": "wrapjax.api",
    "compare": "wrapjax.api",
    "contact": "wrapjax.api",
    "diagnose": "wrapjax.api",
    "effect_meanings": "wrapjax.api",
    "evaluate": "wrapjax.api",
    "exact_geometry": "wrapjax.api",
    "fetch": "wrapjax.api",
    "fit": "wrapjax.api",
    "fit_wraps": "wrapjax.api",
    "initialise": "wrapjax.api",
    "load_fit": "wrapjax.api",
    "load_run": "wrapjax.api",
    "load_subject": "wrapjax.api",
    "objective": "wrapjax.api",
    "physiological_picture": "wrapjax.api",
    "prepare": "wrapjax.api",
    "prepare_subject": "wrapjax.api",
    "uncertainty": "wrapjax.api",
}


def __getattr__(name: str) -> Any:
    if name in _PLACES:
        return getattr(import_module(_PLACES[name]), name)
    raise AttributeError(f"module 'wrapjax' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*_PLACES, "__version__"])


class _Package(ModuleType):
    """This package, whose functions are not hidden by folders of the same name.

    Importing ``wrapjax.calibrate.objective`` makes Python set the folder as ``wrapjax.calibrate``, where
    users expect the function.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _PLACES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
