"""Which muscle is where, by the names that common models give them."""

from __future__ import annotations

import re

#: Names in older models, by those in newer ones.
_SYNONYMS = {
    "addmag1": "addmagProx",
    "addmag2": "addmagMid",
    "addmag3": "addmagIsch",
    "bifemlh": "bflh",
    "bifemsh": "bfsh",
    "ext_dig": "edl",
    "ext_hal": "ehl",
    "flex_dig": "fdl",
    "flex_hal": "fhl",
    "lat_gas": "gaslat",
    "med_gas": "gasmed",
    "per_brev": "perbrev",
    "per_long": "perlong",
    "rect_fem": "recfem",
    "sar": "sart",
    "tib_ant": "tibant",
    "tib_post": "tibpost",
    "vas_int": "vasint",
    "vas_lat": "vaslat",
    "vas_med": "vasmed",
    **{f"glut_{part}{number}": f"gl{part}{number}" for part in ("max", "med", "min") for number in "123"},
}

#: Where muscles lie, as electrodes over them hear one another.
REGIONS: dict[str, tuple[str, ...]] = {
    "hip_front": ("iliacus", "psoas", "sart", "tfl"),
    "hip_side": ("glmed1", "glmed2", "glmed3", "glmin1", "glmin2", "glmin3"),
    "hip_back": ("glmax1", "glmax2", "glmax3", "piri"),
    "thigh_front": ("recfem", "vasint", "vaslat", "vasmed"),
    "thigh_inside": (*("addbrev", "addlong", "addmagDist", "addmagIsch", "addmagMid", "addmagProx", "grac"),),
    "thigh_back": ("bflh", "bfsh", "semimem", "semiten"),
    "shank_front": ("tibant", "edl", "ehl"),
    "shank_side": ("perbrev", "perlong", "pertert"),
    "shank_back": ("gaslat", "gasmed", "soleus", "tibpost", "fdl", "fhl"),
}

#: Regions that lie beside one another.
_BESIDE = {
    frozenset(pair)
    for pair in (
        ("hip_front", "hip_side"),
        ("hip_side", "hip_back"),
        ("hip_front", "thigh_front"),
        ("hip_front", "thigh_inside"),
        ("hip_back", "thigh_back"),
        ("thigh_front", "thigh_inside"),
        ("thigh_inside", "thigh_back"),
        ("shank_front", "shank_side"),
        ("shank_side", "shank_back"),
        ("shank_front", "shank_back"),
    )
}

#: Muscles that are often spastic or shortened after a stroke, by the name of their group.
SPASTIC_GROUPS: dict[str, tuple[str, ...]] = {
    "plantar_flexors": ("soleus", "gasmed", "gaslat"),
    "hamstrings": ("bflh", "bfsh", "semimem", "semiten"),
    "rectus_femoris": ("recfem",),
}

#: Muscles that one drive excites together, for those that no electrode hears.
DRIVEN_TOGETHER: dict[str, tuple[str, ...]] = {
    "hip_flexors": ("iliacus", "psoas"),
    "adductors": REGIONS["thigh_inside"][:6],
    "gluteus_maximus": ("glmax1", "glmax2", "glmax3"),
    "gluteus_medius_and_minimus": REGIONS["hip_side"],
    "hamstrings": ("semimem", "semiten", "bflh"),
    "vasti": ("vasint", "vaslat", "vasmed"),
    "gastrocnemius": ("gaslat", "gasmed"),
    "peronei": ("perbrev", "perlong"),
    "toe_flexors": ("fdl", "fhl"),
    "toe_extensors": ("edl", "ehl"),
}


def plain_name(muscle: str) -> str:
    """Name a muscle without its side, as newer models do."""
    name = re.sub(r"_[lr]$", "", muscle)
    return _SYNONYMS.get(name, name)


def region_of(muscle: str) -> str | None:
    """Say where a muscle lies; None for one that is not listed."""
    name = plain_name(muscle)
    return next((region for region, members in REGIONS.items() if name in members), None)


def are_neighbours(one: str, other: str) -> bool:
    """Say whether two regions are the same or lie beside one another."""
    return one == other or frozenset((one, other)) in _BESIDE


def groups_of(muscles: tuple[str, ...]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Put muscles that one drive excites together into named groups; the others stay on their own."""
    groups: dict[str, tuple[str, ...]] = {}
    for muscle in muscles:
        name = plain_name(muscle)
        group = next((key for key, members in DRIVEN_TOGETHER.items() if name in members), name)
        groups[group] = (*groups.get(group, ()), muscle)
    return tuple(groups.items())
