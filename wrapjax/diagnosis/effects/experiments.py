"""Experiments by which a laboratory can tell effects apart."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Experiment:
    """Recording that shows by itself whether an effect is present.

    The definition of an effect refers to the experiment that shows it; several effects can share one.

    Parameters
    ----------
    text
        What is done in the laboratory.
    minutes
        Duration.
    """

    text: str
    minutes: int


EMG_AT_REST = Experiment("electrodes at rest, the person lying still", 1)
ROD_ON_PLATE = Experiment("press a rod on the plate at known points", 3)
SYNC_PULSE = Experiment("a sync pulse into forces, motion and EMG", 2)
SLOW_PASSIVE_MOTION = Experiment(
    "move the relaxed joint slowly through its range, with a hand-held dynamometer", 5
)
WITHOUT_ORTHOSIS = Experiment("walk without the orthosis, or bench-test it", 5)
PASSIVE_STRETCH_AT_TWO_SPEEDS = Experiment("stretch the relaxed joint at two speeds, with EMG", 6)
STAR_ARC_MOVEMENTS = Experiment("star and arc movements of the hip", 4)
REPEATED_FIRST_TRIAL = Experiment("repeat the first trial at the end of the session", 5)
THIRD_WALKING_SPEED = Experiment("walk at a third speed, twice as fast as the slowest", 5)
SINGLE_MUSCLE_CONTRACTIONS = Experiment("voluntary contractions of single muscles, one after the other", 8)
ISOMETRIC_RAMPS = Experiment("isometric ramps at three joint angles, with EMG", 10)
KNOWN_MASS_AT_SHANK = Experiment("walk with a known mass at the shank", 5)
SQUAT_WITH_CLUSTERS = Experiment("a slow squat with clusters on thigh and shank", 4)
FINE_WIRE_EMG = Experiment("a fine-wire electrode in the deep muscle", 30)
STRETCH_AND_HOLD = Experiment("stretch and hold on a dynamometer", 15)
PATHS_BY_ULTRASOUND = Experiment(
    "slow movements of each joint through its whole range, with motion capture and ultrasound of paths", 30
)
MULTI_SEGMENT_FOOT = Experiment("a multi-segment foot model", 15)

#: All experiments; of two that take equally long, the earlier one is advised.
EXPERIMENTS = (
    EMG_AT_REST,
    ROD_ON_PLATE,
    SYNC_PULSE,
    SLOW_PASSIVE_MOTION,
    WITHOUT_ORTHOSIS,
    PASSIVE_STRETCH_AT_TWO_SPEEDS,
    STAR_ARC_MOVEMENTS,
    REPEATED_FIRST_TRIAL,
    THIRD_WALKING_SPEED,
    SINGLE_MUSCLE_CONTRACTIONS,
    ISOMETRIC_RAMPS,
    KNOWN_MASS_AT_SHANK,
    SQUAT_WITH_CLUSTERS,
    FINE_WIRE_EMG,
    STRETCH_AND_HOLD,
    PATHS_BY_ULTRASOUND,
    MULTI_SEGMENT_FOOT,
)
