"""Numbers, names and counts as the text that pages, tables and figures show."""

from __future__ import annotations

import math

#: Stands for a number that is not defined or not known.
DASH = "\N{EN DASH}"


def counted(number: int, thing: str) -> str:
    """Write a count with its noun: ``1 start``, ``2 starts``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def decimals(value: float | None, places: int = 2) -> str:
    """Write a number with fixed decimals; a dash if it is None or not finite."""
    return DASH if value is None or not math.isfinite(value) else f"{value:.{places}f}"


def p_value(p: float) -> str:
    """Write a p value with three decimals; a dash if it is not defined."""
    return "< 0.001" if p < 0.001 else decimals(p, 3)


def readable(name: str) -> str:
    """Write an identifier with spaces: ``moment_arm_sign`` becomes ``moment arm sign``."""
    return name.replace("_", " ")


def leg_name(side: str) -> str:
    """Write a side, ``l`` or ``r``, as ``Left leg`` or ``Right leg``."""
    return {"l": "Left leg", "r": "Right leg"}[side]
