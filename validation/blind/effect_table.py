"""Table of the simulated effects: their form in the simulator and in the catalogue."""

from __future__ import annotations

from validation.blind.effects import EFFECTS, NOT_SIMULATED
from validation.blind.outside_catalogue import OUTSIDE

_HEAD = """# Simulated effects

Written by `python -m validation.blind forms`. No effect has the same form in the simulator and in the
catalogue, so that a correct diagnosis has identified the cause and not the formula.

| effect | family | form in the simulator | form in the catalogue |
|---|---|---|---|
"""


def effect_table() -> str:
    """Format the table in Markdown."""
    lines = [f"| `{e.id}` | {e.family} | {e.generator_form} | {e.catalogue_form} |" for e in EFFECTS.values()]
    not_simulated = [f"| `{name}` | {why} |" for name, why in NOT_SIMULATED.items()]
    outside = [f"| `{e.id}` | {e.generator_form} | {e.most:g} {e.unit} |" for e in OUTSIDE.values()]
    return (
        _HEAD
        + "\n".join(lines)
        + "\n\n## Catalogue entries that are not simulated\n\n| effect | reason |\n|---|---|\n"
        + "\n".join(not_simulated)
        + "\n\n## Mechanisms outside the catalogue\n\nThe correct answer for these is `unknown`.\n\n"
        + "| mechanism | form in the simulator | largest amount |\n|---|---|---|\n"
        + "\n".join(outside)
        + "\n"
    )
