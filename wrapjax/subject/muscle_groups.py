"""Groups of muscles by name: activation, fiber length, region, spasticity and shared excitation."""

from __future__ import annotations

import re

#: Names of the muscles in newer models (Rajagopal et al.), by their names in older models (gait2392).
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

#: Muscles of each region of the leg; electrodes of the same or adjacent regions are prone to crosstalk.
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

#: Pairs of adjacent regions.
_ADJACENT = {
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

#: Muscles that are often spastic or shortened after a stroke, by group.
SPASTIC_GROUPS: dict[str, tuple[str, ...]] = {
    "plantar_flexors": ("soleus", "gasmed", "gaslat"),
    "hamstrings": ("bflh", "bfsh", "semimem", "semiten"),
    "rectus_femoris": ("recfem",),
}

#: Muscles that share one excitation if none of them has an EMG channel, by group.
SHARED_EXCITATION_GROUPS: dict[str, tuple[str, ...]] = {
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


def standard_name(muscle: str) -> str:
    """Return a muscle's name in newer models, without the suffix of the side."""
    name = re.sub(r"_[lr]$", "", muscle)
    return _SYNONYMS.get(name, name)


def region_of(muscle: str) -> str | None:
    """Return the region of a muscle in `REGIONS`; None for a muscle that is not listed."""
    name = standard_name(muscle)
    return next((region for region, members in REGIONS.items() if name in members), None)


def are_neighbours(first: str, second: str) -> bool:
    """Return whether two regions are the same or adjacent."""
    return first == second or frozenset((first, second)) in _ADJACENT


def group_by_excitation(muscles: tuple[str, ...]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Group muscles by shared excitation; a muscle that is in no group forms a group of its own.

    Returns
    -------
    tuple of (str, tuple of str)
        Name and muscles of each group.
    """
    groups: dict[str, tuple[str, ...]] = {}
    for muscle in muscles:
        name = standard_name(muscle)
        group = next((key for key, members in SHARED_EXCITATION_GROUPS.items() if name in members), name)
        groups[group] = (*groups.get(group, ()), muscle)
    return tuple(groups.items())


#: Activation groups of Rajagopal-type models, without the suffix of the side (Meyer et al. 2017; NMSM
#: Pipeline).
STANDARD_ACTIVATION_GROUPS = (
    ("addbrev", "addlong", "addmagDist", "addmagIsch", "addmagMid", "addmagProx"),
    ("glmax1", "glmax2", "glmax3"),
    ("glmed1", "glmed2", "glmed3"),
    ("glmin1", "glmin2", "glmin3"),
    ("iliacus", "psoas"),
    ("semimem", "semiten"),
    ("bflh", "bfsh"),
    ("perbrev", "perlong"),
)
#: Groups of similar normalised fiber length, from the same source.
STANDARD_FIBER_LENGTH_GROUPS = (
    ("addbrev", "addlong", "addmagDist", "addmagIsch", "addmagMid", "addmagProx"),
    ("glmax1", "glmax2", "glmax3"),
    ("glmed1", "glmed2", "glmed3"),
    ("glmin1", "glmin2", "glmin3"),
    ("vasint", "vaslat", "vasmed"),
    ("semimem", "semiten", "bflh"),
    ("perbrev", "perlong"),
    ("iliacus", "psoas"),
    ("gaslat", "gasmed", "soleus"),
    ("tibant", "edl"),
    ("tibpost", "fdl"),
)


def activation_groups(
    model_groups: dict[str, tuple[str, ...]], driven: tuple[str, ...], side: str
) -> tuple[tuple[str, ...], ...]:
    """Return the groups of driven muscles whose delays and EMG scales are expected to be similar.

    Parameters
    ----------
    model_groups
        Groups of forces of the model. If any has ``ActivationGroup`` in its name, these replace the standard
        groups.
    driven
        Driven muscles. Other muscles, and then groups of fewer than two muscles, are omitted.
    side
        Side of the leg, ``l`` or ``r``.
    """
    return _choose(model_groups, "ActivationGroup", STANDARD_ACTIVATION_GROUPS, driven, side)


def fiber_length_groups(
    model_groups: dict[str, tuple[str, ...]], driven: tuple[str, ...], side: str
) -> tuple[tuple[str, ...], ...]:
    """Return the groups of driven muscles of similar normalised fiber length.

    Parameters are those of `activation_groups`; groups of the model have ``FiberLengthGroup`` in their name.
    """
    return _choose(model_groups, "FiberLengthGroup", STANDARD_FIBER_LENGTH_GROUPS, driven, side)


def _choose(
    model_groups: dict[str, tuple[str, ...]],
    word: str,
    standard: tuple[tuple[str, ...], ...],
    driven: tuple[str, ...],
    side: str,
) -> tuple[tuple[str, ...], ...]:
    # All driven muscles belong to one leg, so that groups of the other leg become empty and are omitted.
    of_model = _at_least_two([members for name, members in model_groups.items() if word in name], driven)
    return of_model or _at_least_two(
        [tuple(f"{name}_{side}" for name in group) for group in standard], driven
    )


def _at_least_two(groups: list[tuple[str, ...]], driven: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    members = (tuple(muscle for muscle in group if muscle in driven) for group in groups)
    return tuple(group for group in members if len(group) >= 2)
