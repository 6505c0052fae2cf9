"""Synthetic results of diagnoses, one for each outcome, with chosen error curves."""

from dataclasses import replace

import numpy as np

from wrapjax.diagnosis.claims.advice import Advice
from wrapjax.diagnosis.claims.gates import Adequate, Gates, Plausible, Specific, Stable
from wrapjax.diagnosis.effects.effect import NotTestable
from wrapjax.diagnosis.fits.baseline import ConvergenceCheck
from wrapjax.diagnosis.fits.verification import ReleasedParameter, VerifiedRefit
from wrapjax.diagnosis.localization import BINS, MuscleShare, repeatable_error_map, split_error
from wrapjax.diagnosis.null_hypotheses.noise_floor import Estimate
from wrapjax.diagnosis.null_hypotheses.undriven_capacity import CapacityShare
from wrapjax.diagnosis.result import DiagnosisResult, EffectFinding, EffectSize
from wrapjax.muscle.personal_law import LAW_NAMES

COORDINATES = ("hip_flexion_l", "knee_angle_l", "ankle_angle_l")
SPEEDS = (0.5, 0.8)
CYCLES = 3
FRAMES = 41
PHASE = np.linspace(0.0, 1.0, FRAMES)
MUSCLES = ("iliacus_l", "recfem_l", "soleus_l", "gasmed_l", "perbrev_l")

ORTHOSIS, CENTER = "ankle_foot_orthosis", "hip_center_offset"


def _bump(place, width, height):
    return height * np.exp(-(((PHASE - place) / width) ** 2))


def _moments():
    """Make speeds, measured moments and missing moments (N m).

    The moment that the orthosis explains is at the ankle and twice as large at the faster speed.
    """
    generator = np.random.default_rng(4)
    speeds = np.repeat(SPEEDS, CYCLES)
    shape = np.stack([_bump(0.1, 0.2, 30.0), _bump(0.2, 0.1, 25.0), -_bump(0.45, 0.15, 90.0)])
    measured = shape[None] * (1.0 + 0.5 * (speeds[:, None, None] - 0.5))
    measured = measured + generator.normal(scale=1.5, size=measured.shape)
    missing = np.zeros_like(measured)
    missing[:, 2] = np.where(speeds > 0.6, 2.0, 1.0)[:, None] * _bump(0.3, 0.12, 6.0)
    missing[:, 1] = 2.0
    return speeds, measured, missing


def finding(id, probability, evidence, detectability=4.0, decision="possible", **others):
    effect_sizes = others.pop("effect_sizes", (EffectSize("size", 0.5, 0.1, "1"),))
    return EffectFinding(id, probability, evidence, detectability, decision, effect_sizes, **others)


def _effects():
    stiffness = EffectSize("dorsiflexion_stiffness", 1.9, 0.3, "N m/deg")
    gains = tuple(EffectSize(f"gain_change_Ch{n}", 0.02 * n, 0.05, "1") for n in range(5))
    return (
        finding(ORTHOSIS, 0.62, 31.0, 7.2, "supported", effect_sizes=(stiffness,)),
        finding(CENTER, 0.2, 27.0, 5.1, "possible"),
        finding("emg_drift", 0.05, 3.0, 2.4, "not supported", effect_sizes=gains),
        finding("slow_fibers", 0.03, -2.0, 1.1, "not detectable"),
        finding("short_range_stiffness", 0.0, -4.0, decision="quiet", negative_control=True),
    )


def _alternative(ids, share, missing, plain, speed=None):
    released = (
        ReleasedParameter("soleus_l.emg_scale", 0.4, -0.1, 0.5, True),
        ReleasedParameter("gasmed_l.optimal_fiber_length", 1.1, 1.4, 0.3, False),
        ReleasedParameter("recfem_l.electromechanical_delay", 0.2, 0.2, 1.0, False),
        *(
            ReleasedParameter(f"muscle{n}_l.tendon_slack_length", 0.0, 0.02 * n, 0.4, n == 3)
            for n in range(12)
        ),
    )
    return VerifiedRefit(
        ids=ids,
        predicted=plain + share * missing,
        held_out_cycles=Estimate(share, share - 0.09, share + 0.1),
        held_out_speed=speed or Estimate(share - 0.04, share - 0.2, share + 0.12),
        gains=(3.1, 4.0, -0.2),
        speed_conflict=1.7,
        released=released,
    )


#: All passed: 2.1 N m left of 2.6, all parts agree, 48 % removed against 21 % by sham effects.
GATES = Gates(
    Adequate(2.1, 2.6),
    Plausible("ankle_foot_orthosis dorsiflexion_stiffness", 1.9, 4.5),
    Stable(1.0, {"odd cycles": ORTHOSIS, "even cycles": ORTHOSIS}),
    Specific(0.48, 0.21),
)


def named() -> DiagnosisResult:
    """Make a result that names the orthosis; the offset of the hip center is second."""
    speeds, measured, missing = _moments()
    plain = measured - missing - np.random.default_rng(5).normal(scale=1.0, size=measured.shape)
    ids = (ORTHOSIS, CENTER, "emg_drift", "slow_fibers")
    likeness = np.array(
        [[0.0, 4.0, 60.0, 200.0], [5.0, 0.0, 40.0, 90.0], [30.0, 30.0, 0.0, 8.0], [3.0, 0.5, 12.0, 0.0]]
    )
    force = np.outer([80.0, -30.0, 240.0, 60.0, 10.0], _bump(0.4, 0.2, 1.0)).reshape(5, 1, FRAMES)
    return DiagnosisResult(
        outcome="named",
        reason="its evidence is above the detection threshold and it holds on all held-out cycles",
        named=(ORTHOSIS,),
        ties=(),
        credible_set=(ORTHOSIS, CENTER),
        effects=_effects(),
        none_probability=0.04,
        unknown_probability=0.06,
        not_testable=(NotTestable("cop_offset", "there are no ground forces"),),
        withheld=("joint_damping",),
        coordinates=COORDINATES,
        trials=tuple(f"walk/{number + 1:02d}" for number in range(len(speeds))),
        recordings=("walk",) * len(speeds),
        uses=("calibration",) * (len(speeds) - 1) + ("validation",),
        speeds=speeds,
        time=np.linspace(np.arange(len(speeds)), np.arange(len(speeds)) + 0.9, FRAMES, axis=1),
        measured=measured,
        plain=plain,
        budget=split_error(measured - plain, (speeds > 0.6).astype(int)),
        budget_speeds=np.array(SPEEDS),
        error_map=repeatable_error_map(
            measured - plain, (speeds > 0.6).astype(int), np.zeros((2, len(COORDINATES), FRAMES))
        ),
        explainable_share=Estimate(0.61, 0.52, 0.7),
        refits=(
            _alternative((ORTHOSIS,), 0.48, missing, plain),
            _alternative((CENTER,), 0.41, missing, plain, Estimate.unknown("there is no other speed")),
        ),
        shares={ORTHOSIS: 0.4, CENTER: 0.1},
        distinguishability=(ids, likeness),
        muscle_share=MuscleShare(MUSCLES, np.repeat(force, 2, axis=1), np.array([0.9, 0.6, 0.95, 0.4, 0.1])),
        detection_threshold=12.4,
        global_p=0.004,
        advice=(Advice((ORTHOSIS, CENTER), "walk once without the orthosis", 3, 2),),
        convergence_check=ConvergenceCheck(
            problems=(),
            costs=(16.97, 16.99, 17.4),
            spread=0.0012,
            decrement=1e-5,
            conflicts={"by_speed": {"emg_scale": 0.7}, "by_half": {"emg_scale": 0.4, "fiber_length": 1.2}},
        ),
        seconds={"calibrate": 41.0, "score": 2.0, "refit": 95.5},
        credible_families=("device", "geometry", "none_of_these"),
        gates=GATES,
        muscle_law=dict.fromkeys(LAW_NAMES, 0.125),
        law_evidence={"nmsm": -12.0, "thelen": 3.25},
        undriven_capacity={name: CapacityShare(0.3, 0.0, 0.2) for name in COORDINATES},
    )


def family() -> DiagnosisResult:
    """Make a result that names a family, as parts of the recording put different members first."""
    return replace(
        named(),
        outcome="family",
        reason="parts of the recording put different effects of one family first",
        named=(),
        family="device",
        family_probability=0.62,
        gates=replace(GATES, stable=Stable(0.5, {"odd cycles": ORTHOSIS, "even cycles": "device_torque"})),
    )


def partial() -> DiagnosisResult:
    """Make a result without a name, as too much error is left and an effect size is at its limit."""
    return replace(
        named(),
        outcome="unknown",
        reason="with ankle_foot_orthosis a repeatable error of 3.1 N m is left",
        named=(),
        best_partial=(ORTHOSIS,),
        gates=replace(
            GATES,
            adequate=Adequate(3.1, 2.6),
            plausible=Plausible("ankle_foot_orthosis dorsiflexion_stiffness", 4.5, 4.5, "N m/deg"),
        ),
    )


def tie() -> DiagnosisResult:
    """Make a result with a tie between the orthosis and the offset of the hip center."""
    return replace(named(), outcome="tie", named=(), ties=((ORTHOSIS, CENTER),), reason="")


def unknown() -> DiagnosisResult:
    """Make a result with an error that no effect explains, although one effect was refitted."""
    quiet = tuple(replace(effect, probability=0.02, evidence=1.0) for effect in _effects())
    return replace(
        named(),
        outcome="unknown",
        reason="no effect's evidence is above the detection threshold, and most of the error remains",
        named=(),
        credible_set=("none_of_these",),
        effects=quiet,
        none_probability=0.05,
        unknown_probability=0.85,
        refits=named().refits[:1],
        shares={},
        advice=(),
        muscle_share=None,
        credible_families=("none_of_these",),
        gates=Gates(Adequate(2.4, 2.6)),
    )


def none() -> DiagnosisResult:
    """Make a result without any effect, so that none was refitted."""
    return replace(
        unknown(),
        outcome="none",
        reason="no effect's evidence is above the detection threshold",
        none_probability=0.85,
        unknown_probability=0.05,
        refits=(),
        explainable_share=Estimate(0.02, -0.06, 0.11),
        global_p=0.6,
    )


def insufficient_data() -> DiagnosisResult:
    """Make a result of too few cycles."""
    return replace(
        named(),
        outcome="insufficient_data",
        reason="two calibration cycles at 0.8 m/s, where three are the fewest",
        named=(),
        credible_set=(),
        effects=(),
        none_probability=0.0,
        unknown_probability=1.0,
        plain=np.full_like(named().plain, np.nan),
        budget=None,
        budget_speeds=np.zeros(0),
        error_map=np.zeros((0, len(COORDINATES), BINS)),
        explainable_share=Estimate.unknown("too few cycles"),
        refits=(),
        shares={},
        distinguishability=((), np.zeros((0, 0))),
        muscle_share=None,
        detection_threshold=np.nan,
        global_p=np.nan,
        advice=(),
        seconds={},
        credible_families=(),
        gates=None,
    )


def not_converged() -> DiagnosisResult:
    """Make a result in which the starts of the calibration ended at different costs."""
    return replace(
        insufficient_data(),
        outcome="not_converged",
        reason="the two best starts end 8 % apart",
        plain=named().plain,
        convergence_check=ConvergenceCheck(("The two best starts end 8 % apart.",), (15.0, 16.2), 0.08, 0.3),
    )


#: Function that makes the result of each outcome.
OUTCOME_MAKERS = {
    make.__name__: make for make in (named, tie, family, unknown, none, insufficient_data, not_converged)
}
