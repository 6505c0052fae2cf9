"""Public names under the module that held them before version 0.2; importing one warns until then."""

import warnings
from typing import Any

import wrapjax


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    warnings.warn(f"wrapjax.api.{name} is now wrapjax.{name}", DeprecationWarning, stacklevel=2)
    return getattr(wrapjax, name)
