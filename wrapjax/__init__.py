"""Calibrate EMG-driven musculoskeletal models with exact gradients.

``load_subject`` reads a subject folder, ``fit`` replaces its muscle paths by polynomials, ``calibrate``
fits the model to the person, ``objective`` gives what is minimised as a pure function for `jax.grad`.
All numbers are SI and radians; JAX must be in 64-bit mode::

    import jax
    jax.config.update("jax_enable_x64", True)
"""

from importlib.metadata import version

from wrapjax.api import Calibration, Fit, calibrate, fit, load_fit, load_subject, objective
from wrapjax.errors import InputError

__version__ = version("wrapjax")
__all__ = [
    "Calibration",
    "Fit",
    "InputError",
    "__version__",
    "calibrate",
    "fit",
    "load_fit",
    "load_subject",
    "objective",
]
