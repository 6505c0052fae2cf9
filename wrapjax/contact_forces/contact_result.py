"""Joint contact forces of a leg over recorded cycles: results, peaks, and division of the knee's force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

#: Compartments of the knee, in the order of arrays.
COMPARTMENTS = ("medial", "lateral")
#: Range of plausible distances between the contact points of a knee, m.
MIN_CONDYLE_DISTANCE, MAX_CONDYLE_DISTANCE = 0.01, 0.12


def knee_compartments(
    on_tibia: Float[np.ndarray, "*batch 6 frame"], distance: float, side: str
) -> Float[np.ndarray, "*batch 2 frame"]:
    """Divide the contact force of a knee between its medial and its lateral compartment.

    The two contact points lie at equal distances on either side of the joint center, and transmit force along
    the tibia only. Together they balance the joint reaction in the frontal plane, as in EMG-driven models of
    the knee (Manal et al. 2015, doi:10.1016/j.joca.2015.02.779). Ligament forces are neglected.

    Parameters
    ----------
    on_tibia
        Moment about the joint center (N m, rows 0 to 2) and force (N, rows 3 to 5) of the femur on the tibia,
        along the axes of the tibia: forward, up, to the right.
    distance
        Distance between the two contact points, m.
    side
        Side of the leg, ``l`` or ``r``.

    Returns
    -------
    array
        Medial and lateral force, N, positive in compression. A negative value means that the compartment
        would open, and that ligaments carry load that this model neglects.
    """
    compression, moment = -on_tibia[..., 4, :], on_tibia[..., 0, :]
    outward = {"r": 1.0, "l": -1.0}[side]
    # A downward force to the right of the center causes a positive moment about the forward axis.
    lateral_excess = outward * moment / distance
    return np.stack([0.5 * compression - lateral_excess, 0.5 * compression + lateral_excess], axis=-2)


#: Gravitational acceleration of OpenSim, m/s^2.
GRAVITY = 9.80665
#: Kinds of contact force: OpenSim's joint reaction, or the contribution of muscles only.
JOINT_REACTION, MUSCLE_SHARE = "joint_reaction", "muscle_share"


@dataclass(frozen=True)
class Undriven:
    """Muscles without an electrode, and the forces that they were given.

    Parameters
    ----------
    treatment
        ``left``, they have no force; ``static-optimization``, they balance the remaining moments.
    muscles
        Muscles with a force.
    without_force
        Muscles without a force.
    activation
        Activations, 0 to 1.
    force
        Tendon forces, N.
    residual_before, residual
        Measured joint moments less those of the driven muscles, and less those of all muscles, N m.
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
    """Contact forces of a leg's joints by one calibration.

    Parameters
    ----------
    label
        Method, with a number and the folder's name where two runs have the same method.
    method, folder, converged
        Method of the run, name of its folder, and whether it converged.
    undriven
        Muscles without an electrode.
    force
        Force of the distal on the proximal body, N, along x (forward), y (up) and z (to the right) of the
        proximal body.
    compartments
        Medial and lateral force of the knee, N; None if the force was not divided.
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
        """Magnitude of the force, N."""
        return np.linalg.norm(self.force, axis=2)


@dataclass(frozen=True)
class ContactResult:
    """Contact forces of one leg by one or two calibrations.

    Parameters
    ----------
    subject, side, mass_kg
        Name of the subject, side of the leg, and body mass in kg.
    kind
        `JOINT_REACTION` or `MUSCLE_SHARE`.
    reason
        Reason for `MUSCLE_SHARE`; otherwise empty.
    joints
        Joints of the model by a short name (``hip``).
    coordinates
        Coordinates with measured moments.
    trials, uses
        Names and uses of the trials.
    time
        Time of each frame, s.
    phase
        Phase of each frame in the gait cycle, %, from `gait_phases`: 0 at the foot strike, above 100 after
        the next one.
    runs
        Contact forces by run.
    condyle_distance
        Distance between the contact points by which the knee's force was divided, m; None if it was not
        divided.
    undivided_reason
        Reason why the knee's force was not divided; otherwise empty.
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
        """Body weight, N."""
        return self.mass_kg * GRAVITY

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the joints, and of the compartments of the knee if its force was divided."""
        sides = [] if self.condyle_distance is None else [compartment_name(side) for side in COMPARTMENTS]
        return (*self.joints, *sides)

    def curves(self, run: RunContact, part: str) -> Float[np.ndarray, "trial frame"]:
        """Return the force on one of the `parts`, N; negative where a compartment would open."""
        if part in self.joints:
            return run.magnitude[:, list(self.joints).index(part)]
        assert run.compartments is not None
        return run.compartments[:, self.parts.index(part) - len(self.joints)]


def compartment_name(side: str) -> str:
    """Return the name of a compartment of the knee among the `parts`."""
    return f"{side} knee"


def peak_windows(joint: str) -> dict[str, tuple[float, float]]:
    """Return the phase window (%) of each reported peak of a joint, by the name of the peak.

    Studies of walking report the hip's first peak, near 20 % of the gait cycle.
    """
    return {"peak": (0.0, 100.0)} | ({"first_peak": (10.0, 30.0)} if joint == "hip" else {})


@dataclass(frozen=True)
class Peaks:
    """Peak force of each cycle within a phase window.

    Parameters
    ----------
    force
        Peak force, in the unit of the curves; NaN where a cycle has no frame in the window.
    phase
        Phase of the peak in the gait cycle, %.
    frame
        Index of its frame.
    """

    force: Float[np.ndarray, " trial"]
    phase: Float[np.ndarray, " trial"]
    frame: Int[np.ndarray, " trial"]


def peaks(
    magnitude: Float[np.ndarray, "trial frame"],
    phase: Float[np.ndarray, "trial frame"],
    window: tuple[float, float],
) -> Peaks:
    """Find the peak force of each cycle.

    Parameters
    ----------
    magnitude
        Force in each frame.
    phase
        Phase of each frame, %, as in `ContactResult`.
    window
        First and last phase of the window, %, both included.

    Returns
    -------
    Peaks
        Peak force of each cycle, its phase and its frame.
    """
    # The last frame of a complete cycle stays at 100 % instead of 0 %.
    within = np.where(phase > 100.0, phase % 100.0, phase)
    inside = (within >= window[0] - 1e-9) & (within <= window[1] + 1e-9)
    frame = np.where(inside, magnitude, -np.inf).argmax(axis=1)
    rows, has_frame = np.arange(len(magnitude)), inside.any(axis=1)
    force, peak_phase = (np.where(has_frame, values[rows, frame], np.nan) for values in (magnitude, within))
    return Peaks(force, peak_phase, frame)
