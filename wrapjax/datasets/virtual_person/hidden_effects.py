"""Effects that can be simulated in a virtual person's recordings without being noted in the subject folder.

A diagnosis should find them. Each is applied to the noise-free recording.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from wrapjax.datasets.virtual_person.anatomy import COORDINATES
from wrapjax.datasets.virtual_person.gait import CHANNELS


@dataclass(frozen=True)
class NoiseFreeRecording:
    """Recording of one leg before measurement noise is added.

    Parameters
    ----------
    speeds
        Walking speed of each cycle, m/s.
    angles
        Joint angles (`COORDINATES`), rad.
    emg_time
        Times of the EMG frames, s.
    emg
        EMG envelopes of all channels (`CHANNELS`).
    moments
        Joint moments (`COORDINATES`), N m.
    missing_channels
        Channels that were not recorded.
    """

    speeds: Float[np.ndarray, " trial"]
    angles: Float[np.ndarray, "trial coordinate frame"]
    emg_time: Float[np.ndarray, "trial padded_frame"]
    emg: Float[np.ndarray, "trial channel padded_frame"]
    moments: Float[np.ndarray, "trial coordinate frame"]
    missing_channels: tuple[str, ...] = ()


def _add_orthosis(recording: NoiseFreeRecording) -> NoiseFreeRecording:
    """Add an ankle-foot orthosis that resists dorsiflexion like a stiff carbon leaf, 2.5 N m per degree."""
    ankle = COORDINATES.index("ankle_angle_r")
    stiffness = np.rad2deg(2.5)
    moments = recording.moments.copy()
    moments[:, ankle] -= stiffness * np.maximum(recording.angles[:, ankle], 0.0)
    return replace(recording, moments=moments)


def _add_emg_drift(recording: NoiseFreeRecording) -> NoiseFreeRecording:
    """Reduce the gain of the soleus electrode from 1.2 in the first cycle to 0.75 in the last one."""
    order = np.linspace(0.0, 1.0, len(recording.speeds))
    emg = recording.emg.copy()
    emg[:, list(CHANNELS).index("Sol")] *= (1.2 - 0.45 * order)[:, None]
    return replace(recording, emg=emg)


def _add_crosstalk(recording: NoiseFreeRecording) -> NoiseFreeRecording:
    """Add 30 % of the tibialis anterior's envelope to the soleus channel, which is silent in swing.

    In the opposite direction calibration would compensate most of it: the tibialis contributes little moment
    in stance.
    """
    names = list(CHANNELS)
    emg = recording.emg.copy()
    emg[:, names.index("Sol")] += 0.3 * recording.emg[:, names.index("TibAnt")]
    return replace(recording, emg=emg)


def _misplace_strikes(recording: NoiseFreeRecording) -> NoiseFreeRecording:
    """Shift EMG against motion by 25 ms, earlier and later in alternating cycles."""
    sign = np.where(np.arange(len(recording.speeds)) % 2 == 0, 1.0, -1.0)
    return _advance_emg(recording, 0.025 * sign)


def _add_speed_dependent_delay(recording: NoiseFreeRecording) -> NoiseFreeRecording:
    """Lengthen the electromechanical delay from the fastest to the slowest speed, by up to 50 ms."""
    span = np.ptp(recording.speeds)
    slowness = (
        (recording.speeds.max() - recording.speeds) / span if span > 0.0 else np.zeros(len(recording.speeds))
    )
    return _advance_emg(recording, 0.05 * slowness)


def _advance_emg(recording: NoiseFreeRecording, advance: Float[np.ndarray, " trial"]) -> NoiseFreeRecording:
    """Shift the EMG of each cycle to earlier times by ``advance`` (s)."""
    emg = np.array(
        [
            [np.interp(time + shift, time, envelope) for envelope in envelopes]
            for time, shift, envelopes in zip(recording.emg_time, advance, recording.emg, strict=True)
        ]
    )
    return replace(recording, emg=emg)


def _remove_hip_flexor_channel(recording: NoiseFreeRecording) -> NoiseFreeRecording:
    """Leave the deep hip flexors without an electrode."""
    return replace(recording, missing_channels=("Iliopsoas",))


#: Functions that simulate an effect, by the identifier of the catalogue's effect that a diagnosis should
#: name.
HIDDEN_EFFECTS: dict[str, Callable[[NoiseFreeRecording], NoiseFreeRecording]] = {
    "ankle_foot_orthosis": _add_orthosis,
    "emg_drift": _add_emg_drift,
    "emg_crosstalk": _add_crosstalk,
    "event_jitter": _misplace_strikes,
    "speed_dependent_delay": _add_speed_dependent_delay,
    "missing_drive": _remove_hip_flexor_channel,
}
