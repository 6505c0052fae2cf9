"""Calibrate EMG-driven musculoskeletal models with exact gradients, and diagnose the remaining error.

``load_subject`` reads a subject folder, which ``prepare_subject`` makes from a laboratory's raw files and
``fetch`` from public recordings. ``inverse_kinematics`` computes joint angles from markers, and
``personalize_joints`` finds the joint centers and axes of the person from them. ``fit`` replaces the
subject's muscle paths by polynomials (``fit_wraps`` makes these depend on the wrapping surfaces),
``initialise`` finds initial muscle lengths, ``calibrate`` fits the model to the person, ``compare`` does so
by several methods, ``uncertainty`` gives intervals of the calibrated parameters, ``diagnose`` finds the
effect that best explains the remaining error (of those in ``effect_meanings``, to which ``register_effect``
adds), ``protocol`` the trials that would tell most, ``diagnose_against`` what differs between two conditions
of one person, ``contact`` computes joint contact forces, ``evaluate`` tests a finished calibration
(``load_run``) on other trials, and ``cohort`` calibrates many subjects. ``show`` writes a page with the model
in motion. ``objective`` returns the calibration's cost as a pure function for `jax.grad`, and
``build_objective`` the object behind it. ``muscle_paths`` computes muscle lengths and moment arms of any
OpenSim model, without recordings.

``write_virtual_subject`` simulates a person with known parameters.

All numbers are in SI units and radians; JAX must be in 64-bit mode, which ``set_up_jax`` sets.
"""

import warnings
from importlib.metadata import version
from typing import Any

import lazy_loader

__version__ = version("wrapjax")

# Names are imported on first use: the command line must set thread counts before JAX is loaded.
_find, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

#: Names of earlier versions, which warn until the next release.
_RENAMED = {"prepare": "build_objective"}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        new = _RENAMED[name]
        warnings.warn(f"wrapjax.{name} is now wrapjax.{new}", DeprecationWarning, stacklevel=2)
        return _find(new)
    if name not in __all__:
        raise AttributeError(f"module 'wrapjax' has no attribute '{name}'")
    return _find(name)
