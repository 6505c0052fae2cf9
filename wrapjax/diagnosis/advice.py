"""What to record next, where a recording cannot tell effects apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from wrapjax.diagnosis.result import Advice

#: Evidence that makes one of two 20 times as likely is 3 nats: half of D.
_ENOUGH = 6.0


@dataclass(frozen=True)
class Experiment:
    """Something a laboratory can record.

    Parameters
    ----------
    text
        What is done.
    minutes
        What it takes.
    shows
        Ids of the effects that it shows, or shows to be absent, by themselves.
    """

    text: str
    minutes: int
    shows: tuple[str, ...]


#: The cheapest first.
MENU = (
    Experiment("electrodes at rest, the person lying still", 1, ("emg_offset",)),
    Experiment("press a rod on the plate at known points", 3, ("cop_offset", "belt_acceleration")),
    Experiment("a sync pulse into forces, motion and EMG", 2, ("force_latency", "speed_dependent_delay")),
    Experiment(
        "move the relaxed joint slowly through its range, with a hand-held dynamometer",
        5,
        ("contracture", "passive_joint_moment", "biarticular_spring"),
    ),
    Experiment("walk without the orthosis, or bench-test it", 5, ("ankle_foot_orthosis", "device_torque")),
    Experiment(
        "stretch the relaxed joint at two speeds, with EMG",
        6,
        ("spasticity_unrecorded", "spasticity_recorded", "joint_damping"),
    ),
    Experiment(
        "star and arc movements of the hip", 4, ("hip_center_offset", "joint_axis_rotation", "knee_laxity")
    ),
    Experiment("repeat the first trial at the end of the session", 5, ("emg_drift",)),
    Experiment(
        "walk at a third speed, twice as fast as the slowest",
        5,
        ("slow_fibers", "tendon_compliance", "deactivation_asymmetry", "event_jitter"),
    ),
    Experiment(
        "voluntary contractions of single muscles, one after the other", 8, ("emg_crosstalk", "force_sharing")
    ),
    Experiment(
        "isometric ramps at three joint angles, with EMG",
        10,
        (
            "activation_dependent_fiber_length",
            "emg_nonlinearity",
            "posture_dependent_gain",
            "curve_family",
            "bound_pressure",
        ),
    ),
    Experiment("walk with a known mass at the shank", 5, ("segment_inertia", "wobbling_mass")),
    Experiment("a slow squat with clusters on thigh and shank", 4, ("soft_tissue_artifact",)),
    Experiment("a fine-wire electrode in the deep muscle", 30, ("missing_drive",)),
    Experiment("stretch and hold on a dynamometer", 15, ("force_enhancement", "short_range_stiffness")),
    Experiment(
        "slow movements of each joint through its whole range, with motion capture and ultrasound of paths",
        30,
        ("wrap_surface", "muscle_attachment"),
    ),
    Experiment("a multi-segment foot model", 15, ("foot_deformation",)),
)


def advise(tie: Sequence[str], least_apart: float, cycles: int) -> Advice | None:
    """Name the cheapest experiment that tells members of a tie apart; None if there is no such one.

    Parameters
    ----------
    tie
        Ids.
    least_apart
        What of the most alike pair cannot be imitated, in squared standard deviations, over all cycles.
    cycles
        How many that was.
    """
    for experiment in sorted(MENU, key=lambda one: one.minutes):
        shown = set(experiment.shows) & set(tie)
        if shown and shown != set(tie):
            more = ceil(_ENOUGH * cycles / least_apart) if least_apart > 0.0 else None
            return Advice(tuple(tie), experiment.text, experiment.minutes, more)
    return None
