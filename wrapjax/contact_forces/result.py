"""How a knee's force divides between its medial and its lateral side.

Contact forces of a leg's joints over recorded cycles, and their peaks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

#: In this order wherever both are given.
COMPARTMENTS = ("medial", "lateral")
#: Distances (m) between the contact points of a knee that make sense.
MIN_CONDYLE_DISTANCE, MAX_CONDYLE_DISTANCE = 0.01, 0.12


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


#: m/s^2; OpenSim's.
GRAVITY = 9.80665
#: What a force is: OpenSim's joint reaction, or what muscles alone press with.
JOINT_REACTION, MUSCLE_SHARE = "joint_reaction", "muscle_share"


@dataclass(frozen=True)
class Undriven:
    """Muscles without an electrode, and what was made of them.

    Parameters
    ----------
    treatment
        ``left``: without force; ``static-optimization``.
    muscles
        That were given a force.
    left_out
        Those that were not.
    activation, force
        From 0 to 1; along the tendon, N.
    residual_before, residual
        Measured joint moments less those of driven muscles alone, and less those of all, N m.
    """

    treatment: str
    muscles: tuple[str, ...]
    without_force: tuple[str, ...]
    activation: Float[np.ndarray, "muscle trial frame"]
    force: Float[np.ndarray, "muscle trial frame"]
    residual_before: Float[np.ndarray, "trial coordinate frame"]
    residual: Float[np.ndarray, "trial coordinate frame"]


@dataclass(frozen=True)
class RunContact:
    """What one calibrated run presses its joints with.

    Parameters
    ----------
    label
        Method, and the folder's name where two have the same.
    method, folder, converged
        Of the run.
    undriven
        Muscles without an electrode.
    force
        What the distal body puts on the proximal one, N, along x (forward), y (up) and z (to the right) of
        that bone.
    compartments
        What presses the medial and the lateral side of the knee together, N; None where that was not asked
        for or cannot be told.
    """

    label: str
    method: str
    folder: str
    converged: bool
    undriven: Undriven
    force: Float[np.ndarray, "trial joint 3 frame"]
    compartments: Float[np.ndarray, "trial 2 frame"] | None = None

    @property
    def magnitude(self) -> Float[np.ndarray, "trial joint frame"]:
        """Size of the force, N."""
        return np.linalg.norm(self.force, axis=2)


@dataclass(frozen=True)
class ContactResult:
    """Contact forces of one leg by one or two runs.

    Parameters
    ----------
    subject, side, mass_kg
        Whose.
    kind, reason
        `JOINT_REACTION` or `MUSCLE_SHARE`, and why it is the latter (else empty).
    joints
        By a plain name (``hip``), the joint in the model.
    coordinates
        Whose moments were measured.
    trials, uses, time
        Cycles; s.
    phase
        Of every frame in the gait cycle, %, as `gait_phases` counts it: from the foot's
        strike, beyond 100 after the next one.
    runs
        In the order given.
    condyle_distance
        Between the points of contact that the knee's force was divided by, m; None where it was not.
    undivided
        Why the knee's force was not divided (else empty).
    """

    subject: str
    side: str
    mass_kg: float
    kind: str
    reason: str
    joints: dict[str, str]
    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    uses: tuple[str, ...]
    time: Float[np.ndarray, "trial frame"]
    phase: Float[np.ndarray, "trial frame"]
    runs: tuple[RunContact, ...]
    condyle_distance: float | None = None
    undivided_reason: str = ""

    @property
    def bodyweight(self) -> float:
        """N."""
        return self.mass_kg * GRAVITY

    @property
    def parts(self) -> tuple[str, ...]:
        """What bears a force: the joints, and the compartments of a knee whose force was divided."""
        sides = [] if self.condyle_distance is None else [compartment_name(side) for side in COMPARTMENTS]
        return (*self.joints, *sides)

    def curves(self, run: RunContact, part: str) -> Float[np.ndarray, "trial frame"]:
        """Give how large the force on one of the `parts` is, N; negative where a compartment would open."""
        if part in self.joints:
            return run.magnitude[:, list(self.joints).index(part)]
        assert run.compartments is not None
        return run.compartments[:, self.parts.index(part) - len(self.joints)]


def compartment_name(side: str) -> str:
    """Name a side of the knee as a part."""
    return f"{side} knee"


def peak_windows(joint: str) -> dict[str, tuple[float, float]]:
    """Name the peaks that are read off a joint, and where in the gait cycle (%) each is looked for.

    The hip's first one is what studies of walking report, near 20 % of the cycle.
    """
    return {"peak": (0.0, 100.0)} | ({"first_peak": (10.0, 30.0)} if joint == "hip" else {})


@dataclass(frozen=True)
class Peaks:
    """Largest force of every cycle within a stretch of it.

    Parameters
    ----------
    force
        N, or the unit of the curves; NaN where a cycle has no frame in that stretch.
    phase
        Where in the gait cycle it is, %.
    frame
        Number of its frame.
    """

    force: Float[np.ndarray, " trial"]
    phase: Float[np.ndarray, " trial"]
    frame: Int[np.ndarray, " trial"]


def peaks(
    magnitude: Float[np.ndarray, "trial frame"],
    phase: Float[np.ndarray, "trial frame"],
    window: tuple[float, float],
) -> Peaks:
    """Find the largest force of every cycle.

    Parameters
    ----------
    magnitude
        Of every frame.
    phase
        As of `ContactResult`.
    stretch
        From and to where in the gait cycle to look, %, both ends included.
    """
    # The last frame of a whole cycle is at 100 %, and not the next one's first.
    within = np.where(phase > 100.0, phase % 100.0, phase)
    inside = (within >= window[0] - 1e-9) & (within <= window[1] + 1e-9)
    frame = np.where(inside, magnitude, -np.inf).argmax(axis=1)
    rows, known = np.arange(len(magnitude)), inside.any(axis=1)
    force, place = (np.where(known, values[rows, frame], np.nan) for values in (magnitude, within))
    return Peaks(force, place, frame)
