"""How a knee's force divides between its medial and its lateral side."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

#: In this order wherever both are given.
COMPARTMENTS = ("medial", "lateral")
#: Distances (m) between the contact points of a knee that make sense.
NARROWEST, WIDEST = 0.01, 0.12


def knee_compartments(
    on_tibia: Float[np.ndarray, "*batch 6 frame"], distance: float, side: str
) -> Float[np.ndarray, "*batch 2 frame"]:
    """Divide what presses a knee together between two points of contact.

    Both lie to either side of the joint's center, equally far, and bear force along the tibia alone; together
    they balance the joint's reaction in the frontal plane, as EMG-driven models of the knee do (Manal et al.
    2015, doi:10.1016/j.joca.2015.02.779). Ligaments bear nothing.

    Parameters
    ----------
    on_tibia
        Moment (N m) about the joint's center, then force (N), that the femur puts on the tibia, along the
        tibia's axes: forward, up, to the right.
    distance
        Between the two points, m.
    side
        ``l`` or ``r``.

    Returns
    -------
    array
        Medial, then lateral, N; positive where it presses. Negative says that this side would be pulled
        apart: there, ligaments have to bear what these points cannot.
    """
    pressed, moment = -on_tibia[..., 4, :], on_tibia[..., 0, :]
    outward = {"r": 1.0, "l": -1.0}[side]
    # What presses down to the right of the center turns the tibia about what points forward.
    more_lateral = outward * moment / distance
    return np.stack([0.5 * pressed - more_lateral, 0.5 * pressed + more_lateral], axis=-2)
