"""Numbers and lists in words, the same way all over the report."""

from __future__ import annotations

import math


def counted(number: int, thing: str) -> str:
    """Count things: ``1 start``, ``2 starts``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def decimals(value: float | None) -> str:
    """Write two decimals; a dash where there is no number."""
    return "\N{EN DASH}" if value is None or not math.isfinite(value) else f"{value:.2f}"


def plain(name: str) -> str:
    """Take a name of the package for words: ``moment_arm_sign`` reads ``moment arm sign``."""
    return name.replace("_", " ")
