"""The virtual person's hidden cylinders: where theirs are, and the model's are not.

What else than muscles may be at work in a virtual person: hidden in what is recorded of it.

The virtual person's hidden truth: parameters of muscles and cylinders that a calibration should find.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.datasets.virtual_person.anatomy import COORDINATES, CYLINDERS
from wrapjax.datasets.virtual_person.gait import CHANNELS
from wrapjax.datasets.virtual_person.leg import FIBER_LENGTH_CENTER, MUSCLES, on_side
from wrapjax.geometry.engine import GEODESIC, PARITY, ExactPaths, PosedPath, wrap_at_samples
from wrapjax.geometry.wrap_bounds import usable_samples
from wrapjax.geometry.wrapped_paths import walls_before
from wrapjax.geometry.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.io.files import write_json
from wrapjax.io.json_and_arrays import load_json
from wrapjax.osim.model import describe_model

#: How far a cylinder may be from the model's, along every parameter, where the spread is one. Chosen here:
#: within the narrowest box that a calibration searches.
LARGEST_CHANGE = np.array([5e-3, 5e-3, 5e-3, np.radians(10.0), np.radians(10.0), 0.1])
#: Draws of a cylinder before it is given up. Most first ones will do.
_DRAWS = 24
# How much further OpenSim's path may be from the shortest one (m) than with the nominal cylinder: more is one
# of its defects.
_DEFECT = 5e-4


def draw_wraps(
    generator: np.random.Generator,
    model_file: Path,
    angles: Float[np.ndarray, "cycle frame coordinate"],
    spread: float,
    side: str = "r",
) -> dict[str, Float[np.ndarray, " wrap_parameter"]]:
    """Draw where a person's cylinders are.

    Parameters
    ----------
    generator
        As much is drawn from it whatever comes of it.
    model_file
        The virtual leg, with nominal cylinders.
    angles
        Of the cycles walked, rad, columns as `COORDINATES`.
    spread
        Largest change of every parameter, in `LARGEST_CHANGE`; draws are uniform.
    side
        Which leg it is.

    Returns
    -------
    dict of Array
        By cylinder, its parameters as in `WRAP_PARAMETERS`: the first draw with which all its muscles'
        paths run as they do round the nominal one, without a jump and touching it, and as far from
        jumping as a calibration keeps them.

    Raises
    ------
    ValueError
        If none of a cylinder's draws will do: the spread is too large.
    """
    model = describe_model(model_file)
    coordinates = tuple(on_side(name, side) for name in COORDINATES)
    draws = generator.uniform(-1.0, 1.0, (len(CYLINDERS), _DRAWS, len(WRAP_PARAMETERS)))
    users = {
        cylinder.name: [muscle.name for muscle in MUSCLES if muscle.cylinder == cylinder.name]
        for cylinder in CYLINDERS
    }
    # All muscles at once: then one program serves all their paths.
    wrapped = [on_side(muscle, side) for muscles in users.values() for muscle in muscles]
    frames = angles.shape[1]
    posed = ExactPaths(model, wrapped, coordinates).posed(angles.reshape(-1, len(coordinates)))
    wraps = {}
    for cylinder, own in zip(CYLINDERS, NOMINAL + spread * LARGEST_CHANGE * draws, strict=True):
        name = on_side(cylinder.name, side)
        paths = [posed[on_side(muscle, side)] for muscle in users[cylinder.name]]
        usable = np.all([_runs_alike(path, own, frames) for path in paths], axis=0)
        if not usable.any():
            raise ValueError(
                f"no place was found for cylinder '{name}': a wrap spread of {spread} is too much"
            )
        wraps[name] = own[usable.argmax()]
    return wraps


def _runs_alike(
    path: PosedPath, samples: Float[np.ndarray, "sample wrap_parameter"], frames: int
) -> Bool[np.ndarray, " sample"]:
    """Tell placements where the shortest path is usable, and OpenSim's, which the person has, follows it.

    Usable, too, for a calibration: one beyond its walls could be found by none.
    """
    moved = np.concatenate([NOMINAL[None], samples])[:, None]
    shortest, others = (wrap_at_samples(path, moved, way) for way in (GEODESIC, PARITY))
    apart = np.abs(others.length - shortest.length).max(axis=1)
    barriers = walls_before(jax.tree.map(lambda leaf: leaf[:1], shortest), frames)
    barriers = jax.tree.map(lambda leaf: leaf[0], barriers)
    proximity = jax.vmap(barriers.proximity)(shortest.clearances[1:], shortest.on_surface[1:])
    within = np.isfinite(np.asarray(proximity)).all(axis=1)
    return usable_samples(path, 0, samples) & within & (apart[1:] <= apart[0] + _DEFECT)


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


#: File of the truth in the folder of a virtual subject.
TRUTH_FILE = "truth.json"

# Middle and half of the range that each quantity is drawn from. Chosen here, well inside what a calibration
# allows; delays after Cavanagh and Komi 1979, doi:10.1007/BF00431022.
_DELAY_S = (0.055, 0.025)
_ACTIVATION_TIME_S = (0.0175, 0.0075)
_NONLINEARITY = (0.10, 0.10)
_SCALE_FACTOR = (1.0, 0.15)
_FIBER_FACTOR = (1.0, 0.10)
#: Of the normalised fiber length's center over the mean gait cycle.
_FIBER_CENTER = (FIBER_LENGTH_CENTER - 0.01, 0.03)
#: Tendon slack length stays within this part of the model's.
_SLACK_LIMIT = 0.10
#: Muscles under one electrode are alike: weight of what they share, the rest being their own.
_SHARED = 0.7


@dataclass(frozen=True)
class VirtualTruth:
    """True parameters, one entry a muscle, and true cylinders.

    Parameters
    ----------
    muscles
        Channel by channel, as a subject's muscles are ordered.
    electromechanical_delay, activation_time_constant
        s.
    activation_nonlinearity, emg_scale
        Without unit; the scale is the excitation where the written channel is 1.
    optimal_fiber_length, tendon_slack_length
        m.
    wraps
        By name, the cylinders that are elsewhere than in the model, as in `WRAP_PARAMETERS`.
    """

    muscles: tuple[str, ...]
    electromechanical_delay: Float[np.ndarray, " muscle"]
    activation_time_constant: Float[np.ndarray, " muscle"]
    activation_nonlinearity: Float[np.ndarray, " muscle"]
    emg_scale: Float[np.ndarray, " muscle"]
    optimal_fiber_length: Float[np.ndarray, " muscle"]
    tendon_slack_length: Float[np.ndarray, " muscle"]
    wraps: Mapping[str, Float[np.ndarray, " wrap_parameter"]] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        """Write `TRUTH_FILE` into a folder."""
        columns = {name: getattr(self, name) for name in parameter_names()}
        per_muscle = {
            muscle: {name: values[row] for name, values in columns.items()}
            for row, muscle in enumerate(self.muscles)
        }
        per_wrap = {
            name: dict(zip(WRAP_PARAMETERS, values, strict=True)) for name, values in self.wraps.items()
        }
        content = {"schema": 1, "units": "SI", "muscles": per_muscle, "wraps": per_wrap}
        write_json(Path(folder) / TRUTH_FILE, content)


def parameter_names() -> tuple[str, ...]:
    """Name the muscles' parameters of `VirtualTruth`, as the model's parameter tree does."""
    return tuple(own.name for own in fields(VirtualTruth) if own.name not in ("muscles", "wraps"))


def read_truth(folder: Path) -> VirtualTruth:
    """Read the truth of a virtual subject from its folder."""
    content = load_json(Path(folder) / TRUTH_FILE)
    per_muscle = content["muscles"]
    columns = {name: np.array([entry[name] for entry in per_muscle.values()]) for name in parameter_names()}
    wraps = {
        name: np.array([values[own] for own in WRAP_PARAMETERS])
        for name, values in content.get("wraps", {}).items()
    }
    return VirtualTruth(muscles=tuple(per_muscle), **columns, wraps=wraps)


def draw_truth(generator: np.random.Generator) -> VirtualTruth:
    """Draw a person.

    Delays lie between 30 and 80 ms, activation time constants between 10 and 25 ms, nonlinearities between 0
    and 0.2, EMG scales within 15 % of the usual ones, fiber and slack lengths within 10 % of the model's.
    Slack lengths follow the fibers so that those go on working where fibers work: a tendon long by a tenth
    would take most of a short fiber's length.
    """
    muscles = tuple(name for channel in CHANNELS.values() for name in channel.scales)
    by_name = {muscle.name: muscle for muscle in MUSCLES}
    chosen = [by_name[name] for name in muscles]
    usual_scale = np.array([scale for channel in CHANNELS.values() for scale in channel.scales.values()])
    channel_of = np.repeat(np.arange(len(CHANNELS)), [len(channel.scales) for channel in CHANNELS.values()])

    def draw(limits: tuple[float, float]) -> Float[np.ndarray, " muscle"]:
        shared = generator.uniform(-1.0, 1.0, len(CHANNELS))[channel_of]
        own = generator.uniform(-1.0, 1.0, len(muscles))
        return limits[0] + limits[1] * (_SHARED * shared + (1.0 - _SHARED) * own)

    fiber = np.array([muscle.optimal_fiber_length for muscle in chosen])
    slack = np.array([muscle.tendon_slack_length for muscle in chosen])
    projection = np.cos([muscle.pennation_angle for muscle in chosen])
    true_fiber = fiber * draw(_FIBER_FACTOR)
    # Where the path's middle length puts the fibers at the drawn center.
    true_slack = slack + (FIBER_LENGTH_CENTER * fiber - draw(_FIBER_CENTER) * true_fiber) * projection
    return VirtualTruth(
        muscles=muscles,
        electromechanical_delay=draw(_DELAY_S),
        activation_time_constant=draw(_ACTIVATION_TIME_S),
        activation_nonlinearity=draw(_NONLINEARITY),
        emg_scale=usual_scale * draw(_SCALE_FACTOR),
        optimal_fiber_length=true_fiber,
        tendon_slack_length=np.clip(true_slack, (1.0 - _SLACK_LIMIT) * slack, (1.0 + _SLACK_LIMIT) * slack),
    )


def draw_other_leg(right: VirtualTruth, generator: np.random.Generator) -> VirtualTruth:
    """Draw a person's left leg to the right one.

    Delays and EMG scales are drawn anew. Activation constants and lengths are the person's: the same.
    """
    own = draw_truth(generator)
    return replace(
        right,
        muscles=tuple(on_side(name, "l") for name in right.muscles),
        electromechanical_delay=own.electromechanical_delay,
        emg_scale=own.emg_scale,
    )
