"""Settings of the simulated laboratories and walkers, and the eight development worlds of the bank `worlds`.

Defaults are the settings of the banks `test`, `second_test` and `development`. The first two worlds have
these settings with the two families of the development bank; the others differ as their names state.
"""

from __future__ import annotations

from dataclasses import dataclass, field

SLOW_AND_USUAL = ((0.5, 0.8, 0.65), (0.5, 0.8, 1.0), (0.6, 1.0, 0.8), (0.7, 1.1, 1.3), (0.8, 1.2, 1.0))


@dataclass(frozen=True)
class EmgSettings:
    """Noise and processing of the recorded envelopes."""

    #: Three levels of noise relative to the envelope.
    levels: tuple[float, float, float] = (0.05, 0.10, 0.20)
    #: Correlation width of the noise, s.
    time: float = 0.030
    #: Noise in pauses relative to that in bursts.
    pause: float = 0.10
    #: Additional noise that is independent of the envelope, of full scale; rectified, so it raises pauses.
    baseline: float = 0.0
    #: Cutoff frequency of the envelopes, Hz.
    cutoff: float = 6.0
    #: Channels that are not recorded; their muscles are active all the same.
    unrecorded: tuple[str, ...] = ()


@dataclass(frozen=True)
class GeometrySettings:
    """Standard deviations of the true leg's geometry about the nominal one."""

    #: Muscle points and cylinder centers, m.
    points: float = 0.0012
    #: Radius of cylinders, share.
    radius: float = 0.02
    #: Distance of the true hip, knee and ankle centers from the nominal ones in everybody, m.
    centers: float = 0.0


@dataclass(frozen=True)
class PersonSettings:
    """Means and standard deviations of muscle parameters."""

    #: Logarithm of the optimal fiber length.
    fiber: float = 0.06
    #: Tendon slack length, in optimal fiber lengths.
    slack: float = 0.04
    #: Electromechanical delay and its standard deviation between channels, s.
    delay: float = 0.045
    delay_spread: float = 0.010
    #: Activation nonlinearity, 0 to 1.
    bend: float = 0.28
    #: Activation time, s.
    rise: float = 0.016


@dataclass(frozen=True)
class GaitSettings:
    """Walking: speeds, variability and deviations from typical gait."""

    #: Speeds (m/s) that a person may walk at; the last of each three is held out.
    speeds: tuple[tuple[float, ...], ...] = SLOW_AND_USUAL
    overground: bool = False
    #: Used cycles of each recording.
    calibration: int = 5
    validation: int = 2
    #: Cycle duration relative to that of healthy adults at the same speed.
    period: float = 1.0
    #: Standard deviations of cycle duration, and of amplitudes relative to those of the treadmill.
    period_spread: float = 0.015
    variability: float = 1.0
    #: Factors of the ranges of motion of coordinates.
    ranges: tuple[tuple[str, float], ...] = ()
    #: Additional bursts: channel, center and width (% of the cycle), activation.
    bursts: tuple[tuple[str, float, float, float], ...] = ()


@dataclass(frozen=True)
class MomentSettings:
    """Noise of measured moments: factor of the standard deviations, and correlation width in cycles."""

    noise: float = 1.0
    phase: float = 0.030


@dataclass(frozen=True)
class BackgroundSettings:
    """Deviations that are present in all recordings of a world and are no cause of a case."""

    #: Constant added to an envelope in one recording: channel, number of the recording, of full scale.
    emg_baseline: tuple[str, int, float] | None = None
    #: Range of the root mean square of the unmodelled moment at each joint, N m.
    unmodelled: tuple[float, float] | None = None


@dataclass(frozen=True)
class WorldSettings:
    """Settings of a world, by name; ``seed`` is that of its persons and cases in the bank `worlds`."""

    name: str
    family: str
    seed: int = 0
    summary: str = ""
    emg: EmgSettings = field(default=EmgSettings())
    geometry: GeometrySettings = field(default=GeometrySettings())
    person: PersonSettings = field(default=PersonSettings())
    gait: GaitSettings = field(default=GaitSettings())
    moments: MomentSettings = field(default=MomentSettings())
    background: BackgroundSettings = field(default=BackgroundSettings())


USUAL_EMG, USUAL_GAIT, USUAL_MOMENTS = EmgSettings(), GaitSettings(), MomentSettings()


def default_world(family: str) -> WorldSettings:
    """Return the default settings with a family of curves, as in the banks other than `worlds`."""
    return WorldSettings(family, family)


_HIP_CHANNELS = ("Iliopsoas", "GlutMax", "GlutMed", "Adductors")

WORLDS: dict[str, WorldSettings] = {
    world.name: world
    for world in (
        WorldSettings("thelen", "thelen", 70_101, "half of the development bank"),
        WorldSettings("spline", "spline", 70_202, "the other half of the development bank"),
        WorldSettings(
            "overground_few_cycles",
            "polynomial",
            70_303,
            "fast overground walking, 3 variable cycles per speed, no EMG of deep hip flexors",
            EmgSettings(cutoff=8.0, time=0.022, unrecorded=("Iliopsoas",)),
            gait=GaitSettings(
                speeds=((0.9, 1.3, 1.1), (1.0, 1.4, 1.2), (1.0, 1.5, 1.25), (0.8, 1.3, 1.5)),
                overground=True,
                calibration=3,
                period=0.97,
                period_spread=0.025,
                variability=1.5,
            ),
            moments=MomentSettings(1.1, 0.025),
        ),
        WorldSettings(
            "knee_and_ankle_emg",
            "gordon",
            70_404,
            "9 channels: none at the iliopsoas, gluteal muscles and adductors",
            EmgSettings(cutoff=5.0, unrecorded=_HIP_CHANNELS),
            GeometrySettings(points=0.0015, radius=0.03, centers=0.001),
            gait=GaitSettings(speeds=((0.6, 1.0, 0.8), (0.7, 1.1, 1.3), (0.8, 1.2, 1.0))),
        ),
        WorldSettings(
            "stiff_knee",
            "gordon",
            70_505,
            "slow gait with a stiff knee; muscle parameters far from the nominal ones",
            EmgSettings(levels=(0.07, 0.12, 0.20)),
            GeometrySettings(points=0.0018, radius=0.03, centers=0.0015),
            PersonSettings(fiber=0.11, slack=0.07, delay=0.055, delay_spread=0.016, bend=0.36, rise=0.020),
            GaitSettings(
                speeds=((0.3, 0.5, 0.4), (0.35, 0.55, 0.7), (0.4, 0.65, 0.5)),
                calibration=4,
                validation=1,
                period=0.92,
                period_spread=0.022,
                variability=1.4,
                ranges=(("knee_angle_r", 0.6), ("pelvis_list", 1.7), ("ankle_angle_r", 0.75)),
                bursts=(
                    ("RecFem", 66.0, 9.0, 0.20),
                    ("VastLat", 50.0, 10.0, 0.08),
                    ("Soleus", 10.0, 8.0, 0.12),
                ),
            ),
        ),
        WorldSettings(
            "faulty_laboratory",
            "polynomial",
            70_606,
            "noisy EMG and moments; a raised soleus envelope in the second recording of everybody",
            EmgSettings(levels=(0.10, 0.20, 0.32), time=0.045, baseline=0.02, cutoff=4.0),
            moments=MomentSettings(1.5, 0.040),
            background=BackgroundSettings(("Soleus", 1, 0.06)),
        ),
        WorldSettings(
            "wrong_geometry",
            "polynomial",
            70_707,
            "generic model: points displaced by 3 mm, cylinders by 3 mm and 8 %, joint centers by 3 mm",
            EmgSettings(levels=(0.05, 0.08, 0.15), cutoff=7.0),
            GeometrySettings(points=0.003, radius=0.08, centers=0.003),
            PersonSettings(fiber=0.08, slack=0.05, delay=0.035),
            moments=MomentSettings(0.8, 0.030),
        ),
        WorldSettings(
            "gross_misfit",
            "gordon",
            70_808,
            "unmodelled moments of 8 to 12 N m RMS at every joint, equal in all cycles",
            geometry=GeometrySettings(points=0.002, radius=0.04, centers=0.002),
            background=BackgroundSettings(unmodelled=(8.0, 12.0)),
        ),
    )
}
