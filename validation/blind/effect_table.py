"""The table of forms: the generator's beside the catalogue's."""

from __future__ import annotations

from validation.blind.effects import EFFECTS, LEFT_OUT
from validation.blind.outside_catalogue import OUTSIDE

_HEAD = """# What the generator does, and what the catalogue says

Written by `python -m validation.blind forms`. No effect has the catalogue's form here: a diagnosis that is
right has found the cause, not the formula.

| effect | place | in the generator | in the catalogue |
|---|---|---|---|
"""


def forms_text() -> str:
    lines = [f"| `{e.id}` | {e.family} | {e.own_form} | {e.catalogue_form} |" for e in EFFECTS.values()]
    left = [f"| `{name}` | {why} |" for name, why in LEFT_OUT.items()]
    outside = [f"| `{e.id}` | {e.own_form} | {e.most:g} {e.unit} |" for e in OUTSIDE.values()]
    return (
        _HEAD
        + "\n".join(lines)
        + "\n\n## In no case\n\n| catalogued | why |\n|---|---|\n"
        + "\n".join(left)
        + "\n\n## Outside the catalogue\n\nA diagnosis should call these unknown.\n\n"
        + "| mechanism | in the generator | at most |\n|---|---|---|\n"
        + "\n".join(outside)
        + "\n"
    )
