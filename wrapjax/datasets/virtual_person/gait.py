"""Walking of the virtual person: joint angles and EMG envelopes as smooth functions of time.

Both are periodic over the gait cycle, which starts at heel strike. Cycles vary randomly and smoothly in
amplitude, timing and shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.datasets.virtual_person.anatomy import COORDINATES

#: Walking speed of the curves below, m/s.
NATURAL_SPEED = 1.2

# Joint angles of able-bodied adults at natural speed, degrees, at 0, 5, ..., 95 % of the gait cycle: rounded
# values that follow the mean curves of Winter 1991 (The biomechanics and motor control of human gait,
# 2nd ed.) in the sagittal plane, of Bovi et al. 2011 (A multiple-task gait analysis approach,
# doi:10.1016/j.gaitpost.2010.08.009) in the others and of Rattanaprasert et al. 1999 (Clin Biomech 14:14) at
# the subtalar joint; not digitised from them. OpenSim's signs: flexion, adduction, internal rotation,
# dorsiflexion and inversion are positive.
_ANGLES_DEG = {
    "hip_flexion_r": (28, 27, 25, 21, 16, 11, 6, 1.5, -3, -7, -10, -9, -3, 6, 15, 23, 28, 31, 31, 29),
    "hip_adduction_r": (0, 3, 6, 7, 6.5, 5.5, 5, 4.5, 4, 3, 1, -2, -5, -6, -5, -3.5, -2.5, -2, -1.5, -1),
    "hip_rotation_r": (-3, -1, 1, 2, 2, 2, 2.5, 3, 4, 4, 3, 0, -3, -5, -5, -4, -3, -3, -4, -4),
    "knee_angle_r": (5, 10, 16, 19, 18, 15, 11, 8, 6, 7, 11, 20, 34, 49, 59, 61, 54, 40, 22, 9),
    "ankle_angle_r": (0, -5, -4, 0, 3.5, 5.5, 7, 8.5, 10, 11, 9.5, 2, -11, -17, -11, -4, 0, 2, 2.5, 1.5),
    "subtalar_angle_r": (
        2,
        -1,
        -3.5,
        -4.5,
        -4.5,
        -4.5,
        -4,
        -3.5,
        -2,
        0,
        3,
        6,
        7,
        6,
        4,
        3,
        2.5,
        2.5,
        2.5,
        2.5,
    ),
}

#: Number of harmonics of the angles: 99 % of the power of walking lies below 6 Hz (Winter 2009, Biomechanics
#: and motor control of human movement, 4th ed., section 3.4).
_HARMONICS = 6
#: Chosen here: relative change of excursions per m/s, about as in Bovi et al. 2011.
_EXCURSION_PER_SPEED = 0.25
#: Chosen here: relative change of EMG per m/s, about as in Hof et al. 2002,
#: doi:10.1016/S0966-6362(01)00206-5.
_EMG_PER_SPEED = 0.55

# Mean (column 0) and complex amplitudes of the harmonics, rad.
_SPECTRUM = np.fft.rfft(np.radians([_ANGLES_DEG[name] for name in COORDINATES]))[:, : _HARMONICS + 1]
_SPECTRUM *= np.array([1.0] + [2.0] * _HARMONICS) / 20


@dataclass(frozen=True)
class Burst:
    """A burst of an EMG envelope.

    Parameters
    ----------
    center, width
        Center and standard deviation of a bell-shaped curve, as fractions of the gait cycle.
    height
        Height of the curve, relative to the channel's largest burst.
    """

    center: float
    width: float
    height: float


@dataclass(frozen=True)
class Channel:
    """An EMG electrode.

    Parameters
    ----------
    bursts
        Bursts of the envelope at 1.2 m/s.
    scales
        Typical excitation (0 to 1) at the peak of the envelope, of each muscle that the channel drives.
    """

    bursts: tuple[Burst, ...]
    scales: dict[str, float]


# Timing: Perry and Burnfield 2010 (Gait analysis, 2nd ed., chapters 4 to 7) and Winter and Yack 1987
# (doi:10.1016/0013-4694(87)90003-4). Chosen here: the shape of the curves, and heights and scales such that
# the joint moments at 1.2 m/s resemble Winter's (1991).
CHANNELS: dict[str, Channel] = {
    "AddLong": Channel(
        (Burst(0.63, 0.07, 1.0), Burst(0.02, 0.07, 0.75)),
        {
            "addbrev_r": 0.12,
            "addlong_r": 0.12,
            "addmagIsch_r": 0.12,
            "addmagMid_r": 0.12,
            "addmagProx_r": 0.12,
        },
    ),
    "BicFemLong": Channel(
        (Burst(0.95, 0.07, 1.0), Burst(0.08, 0.07, 0.35)),
        {"bflh_r": 0.25, "bfsh_r": 0.45},
    ),
    "GasMed": Channel(
        (Burst(0.42, 0.08, 1.0), Burst(0.22, 0.09, 0.15)),
        {"gaslat_r": 0.45, "gasmed_r": 0.45},
    ),
    "GlutMax": Channel(
        (Burst(0.05, 0.07, 1.0),),
        {"glmax1_r": 0.20, "glmax2_r": 0.20, "glmax3_r": 0.20},
    ),
    "GlutMed": Channel(
        (Burst(0.09, 0.07, 1.0), Burst(0.32, 0.09, 0.80)),
        {
            "glmed1_r": 0.75,
            "glmed2_r": 0.75,
            "glmed3_r": 0.75,
            "glmin1_r": 0.70,
            "glmin2_r": 0.70,
            "glmin3_r": 0.70,
        },
    ),
    "Iliopsoas": Channel(
        (Burst(0.40, 0.08, 1.0), Burst(0.58, 0.08, 0.60)),
        {"iliacus_r": 0.70, "psoas_r": 0.50},
    ),
    "PeroneusLong": Channel(
        (Burst(0.44, 0.09, 1.0), Burst(0.15, 0.08, 0.45)),
        {"perbrev_r": 0.40, "perlong_r": 0.45},
    ),
    "RecFem": Channel(
        (Burst(0.08, 0.06, 1.0), Burst(0.58, 0.06, 0.45)),
        {"recfem_r": 0.42},
    ),
    "SemiMemb": Channel(
        (Burst(0.94, 0.07, 1.0), Burst(0.06, 0.06, 0.45)),
        {"semimem_r": 0.20, "semiten_r": 0.20},
    ),
    "Sol": Channel(
        (Burst(0.43, 0.08, 1.0), Burst(0.20, 0.10, 0.20)),
        {"soleus_r": 0.45},
    ),
    "TibAnt": Channel(
        (Burst(0.64, 0.06, 1.0), Burst(0.03, 0.06, 0.80), Burst(0.85, 0.10, 0.35)),
        {"tibant_r": 0.50},
    ),
    "TibPost": Channel(
        (Burst(0.40, 0.10, 1.0), Burst(0.12, 0.07, 0.40)),
        {"tibpost_r": 0.40},
    ),
    "VastLat": Channel(
        (Burst(0.07, 0.06, 1.0), Burst(0.95, 0.05, 0.30)),
        {"vasint_r": 0.20, "vaslat_r": 0.20},
    ),
    "VastMed": Channel(
        (Burst(0.07, 0.06, 1.0), Burst(0.95, 0.05, 0.30)),
        {"vasmed_r": 0.22},
    ),
}
#: Chosen here: envelope between bursts.
_BASELINE = 0.01


def cycle_time(speed: float) -> float:
    """Compute the duration of a gait cycle (s) at a walking speed (m/s).

    Stride length grows with the square root of speed (Grieve and Gear 1966, doi:10.1080/00140136608964399)
    and is 1.34 m at 1.2 m/s.
    """
    return 1.34 * np.sqrt(speed / NATURAL_SPEED) / speed


@dataclass(frozen=True)
class WalkingCycle:
    """One gait cycle and its differences from the mean cycle; periodic beyond its ends.

    Parameters
    ----------
    start, duration
        Start and duration, s.
    speed
        Walking speed, m/s.
    warp
        Sine and cosine amplitudes of the phase advance, as fractions of the cycle.
    angle_gain
        Factors on the excursions of the angles.
    angle_change
        Offsets (column 0) and complex amplitudes of harmonics added to the angles, rad.
    burst_gain, burst_shift
        Factors on the heights of the bursts and shifts of their centers (fractions of the cycle), by channel.
    """

    start: float
    duration: float
    speed: float
    warp: tuple[float, float]
    angle_gain: Float[np.ndarray, " coordinate"]
    angle_change: np.ndarray
    burst_gain: dict[str, Float[np.ndarray, " burst"]]
    burst_shift: dict[str, Float[np.ndarray, " burst"]]

    @property
    def end(self) -> float:
        """End of the cycle in s: the next heel strike."""
        return self.start + self.duration

    def _phase(self, time: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
        phase = (time - self.start) / self.duration
        turn = 2.0 * np.pi * phase
        # The phase advance is zero at heel strike, where cycles begin and end.
        return phase + self.warp[0] * np.sin(turn) + self.warp[1] * (np.cos(turn) - 1.0)

    def angles(self, time: Float[np.ndarray, " frame"]) -> Float[np.ndarray, "coordinate frame"]:
        """Compute the joint angles (`COORDINATES`, rad) at times (s)."""
        excursion = self.angle_gain * (1.0 + _EXCURSION_PER_SPEED * (self.speed - NATURAL_SPEED))
        spectrum = _SPECTRUM.copy()
        spectrum[:, 1:] *= excursion[:, None]
        spectrum[:, : self.angle_change.shape[1]] += self.angle_change
        turns = np.exp(2j * np.pi * np.outer(np.arange(_HARMONICS + 1), self._phase(time)))
        return (spectrum @ turns).real

    def emg(self, time: Float[np.ndarray, " frame"]) -> Float[np.ndarray, "channel frame"]:
        """Compute the EMG envelopes (`CHANNELS`, in units of burst heights) at times (s)."""
        phase = self._phase(time)
        gain = 1.0 + _EMG_PER_SPEED * (self.speed - NATURAL_SPEED)
        envelopes = []
        for name, channel in CHANNELS.items():
            total = np.full(time.shape, _BASELINE)
            varied = zip(channel.bursts, self.burst_gain[name], self.burst_shift[name], strict=True)
            for burst, factor, shift in varied:
                # A periodic bell-shaped curve (von Mises).
                turn = 2.0 * np.pi * (phase - burst.center - shift)
                bell = np.exp((np.cos(turn) - 1.0) / (2.0 * np.pi * burst.width) ** 2)
                total += gain * factor * burst.height * bell
            envelopes.append(total)
        return np.array(envelopes)


def normative_cycle(speed: float = NATURAL_SPEED) -> WalkingCycle:
    """Return the mean gait cycle at a walking speed (m/s), starting at time zero."""
    return draw_cycle(np.random.default_rng(0), speed, 0.0, variation=0.0)


def draw_cycle(
    generator: np.random.Generator, speed: float, start: float, *, variation: float = 1.0
) -> WalkingCycle:
    """Draw a random gait cycle.

    Standard deviations, chosen here after the within-person variability of Winter 1991, are: duration
    2 %, excursions 4 %, offsets and first three harmonics 0.6 degrees each, heights of EMG bursts 12 %,
    their timing 1 % of the cycle, phase 0.5 %.

    Parameters
    ----------
    generator
        Random generator.
    speed
        Walking speed, m/s.
    start
        Start of the cycle, s.
    variation
        Factor on all standard deviations.
    """

    def normal(spread: float, *shape: int) -> np.ndarray:
        return variation * spread * generator.standard_normal(shape)

    count = len(COORDINATES)
    change = normal(np.radians(0.6), count, 4) + 1j * normal(np.radians(0.6), count, 4)
    return WalkingCycle(
        start=start,
        duration=float(cycle_time(speed) * (1.0 + normal(0.02, 1)[0])),
        speed=speed,
        warp=(float(normal(0.005, 1)[0]), float(normal(0.005, 1)[0])),
        angle_gain=1.0 + normal(0.04, count),
        angle_change=change,
        burst_gain={name: np.exp(normal(0.12, len(channel.bursts))) for name, channel in CHANNELS.items()},
        burst_shift={name: normal(0.01, len(channel.bursts)) for name, channel in CHANNELS.items()},
    )
