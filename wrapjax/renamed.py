"""Argument names of earlier versions, which warn until the next release."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import ParamSpec, TypeVar

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def renamed_arguments(
    **names: str,
) -> Callable[[Callable[_Arguments, _Result]], Callable[_Arguments, _Result]]:
    """Accept earlier names of keyword arguments, with a `DeprecationWarning`.

    Parameters
    ----------
    **names
        Present name by earlier name.
    """

    def decorate(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
        @functools.wraps(function)
        def renaming(*arguments: _Arguments.args, **options: _Arguments.kwargs) -> _Result:
            for earlier in names.keys() & options.keys():
                message = f"argument '{earlier}' of {function.__name__}() is now '{names[earlier]}'"
                warnings.warn(message, DeprecationWarning, stacklevel=2)
                options[names[earlier]] = options.pop(earlier)
            return function(*arguments, **options)

        return renaming

    return decorate
