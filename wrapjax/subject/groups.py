"""Muscles that act alike: groups whose parameters a calibration keeps similar."""

from __future__ import annotations

#: Activation groups of Rajagopal-type models, without the side (Meyer et al. 2017; NMSM Pipeline).
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
    """Choose the groups that share their excitation's timing and scale.

    Parameters
    ----------
    model_groups
        The model's groups of forces. Those with ``ActivationGroup`` in their name win over the standard ones.
    driven
        Muscles that an EMG channel drives; others are left out, and with them groups of fewer than two.
    side
        ``l`` or ``r``.
    """
    return _choose(model_groups, "ActivationGroup", STANDARD_ACTIVATION_GROUPS, driven, side)


def fiber_length_groups(
    model_groups: dict[str, tuple[str, ...]], driven: tuple[str, ...], side: str
) -> tuple[tuple[str, ...], ...]:
    """Choose the groups of similar normalised fiber length: ``FiberLengthGroup`` ones, else standard."""
    return _choose(model_groups, "FiberLengthGroup", STANDARD_FIBER_LENGTH_GROUPS, driven, side)


def _choose(
    model_groups: dict[str, tuple[str, ...]],
    word: str,
    standard: tuple[tuple[str, ...], ...],
    driven: tuple[str, ...],
    side: str,
) -> tuple[tuple[str, ...], ...]:
    # The muscles driven are all of one leg, so that groups of the other leg drop out with their members.
    own = _at_least_two([members for name, members in model_groups.items() if word in name], driven)
    return own or _at_least_two([tuple(f"{name}_{side}" for name in group) for group in standard], driven)


def _at_least_two(groups: list[tuple[str, ...]], driven: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    kept = (tuple(muscle for muscle in group if muscle in driven) for group in groups)
    return tuple(group for group in kept if len(group) >= 2)
