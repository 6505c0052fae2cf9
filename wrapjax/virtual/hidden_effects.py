"""What else than muscles may be at work in a virtual person: hidden in what is recorded of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from wrapjax.virtual.anatomy import COORDINATES
from wrapjax.virtual.gait import CHANNELS


@dataclass(frozen=True)
class Recorded:
    """What a laboratory gets of a leg, before noise.

    Parameters
    ----------
    speeds, angles
        Of each cycle, m/s; rad.
    emg_time, emg
        s, and the envelopes of all channels.
    moments
        N m.
    unheard
        Channels that have no electrode.
    """

    speeds: Float[np.ndarray, " trial"]
    angles: Float[np.ndarray, "trial coordinate frame"]
    emg_time: Float[np.ndarray, "trial padded_frame"]
    emg: Float[np.ndarray, "trial channel padded_frame"]
    moments: Float[np.ndarray, "trial coordinate frame"]
    unheard: tuple[str, ...] = ()


def _orthosis(recorded: Recorded) -> Recorded:
    """Resist dorsiflexion like a stiff carbon leaf, 2.5 N m a degree."""
    ankle = COORDINATES.index("ankle_angle_r")
    stiffness = np.rad2deg(2.5)
    moments = recorded.moments.copy()
    moments[:, ankle] -= stiffness * np.maximum(recorded.angles[:, ankle], 0.0)
    return replace(recorded, moments=moments)


def _drift(recorded: Recorded) -> Recorded:
    """Let the electrode of the soleus lose its gel: 45 % from the first to the last cycle."""
    order = np.linspace(0.0, 1.0, len(recorded.speeds))
    emg = recorded.emg.copy()
    emg[:, list(CHANNELS).index("Sol")] *= (1.2 - 0.45 * order)[:, None]
    return replace(recorded, emg=emg)


def _crosstalk(recorded: Recorded) -> Recorded:
    """Let the electrode over the soleus hear 30 % of the tibialis anterior, in swing too, when it is silent.

    The other way round calibration would hide most of it: the tibialis has little to do in stance.
    """
    names = list(CHANNELS)
    emg = recorded.emg.copy()
    emg[:, names.index("Sol")] += 0.3 * recorded.emg[:, names.index("TibAnt")]
    return replace(recorded, emg=emg)


def _misplaced_strikes(recorded: Recorded) -> Recorded:
    """Let EMG run 25 ms ahead of motion in every other cycle, and as much behind it in the others."""
    turn = np.where(np.arange(len(recorded.speeds)) % 2 == 0, 1.0, -1.0)
    return _shifted(recorded, 0.025 * turn)


def _slow_delay(recorded: Recorded) -> Recorded:
    """Let muscles answer 50 ms later at the slowest speed than at the fastest."""
    span = np.ptp(recorded.speeds)
    share = (recorded.speeds.max() - recorded.speeds) / span if span > 0.0 else np.zeros(len(recorded.speeds))
    return _shifted(recorded, 0.05 * share)


def _shifted(recorded: Recorded, ahead: Float[np.ndarray, " trial"]) -> Recorded:
    """Record EMG of each cycle so much (s) earlier than it acts."""
    emg = np.array(
        [
            [np.interp(time + own, time, envelope) for envelope in envelopes]
            for time, own, envelopes in zip(recorded.emg_time, ahead, recorded.emg, strict=True)
        ]
    )
    return replace(recorded, emg=emg)


def _unheard_hip_flexors(recorded: Recorded) -> Recorded:
    """Leave the deep hip flexors without an electrode."""
    return replace(recorded, unheard=("Iliopsoas",))


#: What may be hidden, by the id of the effect that a diagnosis should name.
HIDDEN_EFFECTS: dict[str, Callable[[Recorded], Recorded]] = {
    "ankle_foot_orthosis": _orthosis,
    "emg_drift": _drift,
    "emg_crosstalk": _crosstalk,
    "event_jitter": _misplaced_strikes,
    "speed_dependent_delay": _slow_delay,
    "missing_drive": _unheard_hip_flexors,
}
