"""The virtual person's hidden truth: parameters of muscles and cylinders that a calibration should find."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.files import write_json
from wrapjax.geometry.surfaces import WRAP_PARAMETERS
from wrapjax.stored import load_json
from wrapjax.virtual.gait import CHANNELS
from wrapjax.virtual.mirror import on_side
from wrapjax.virtual.muscles import FIBER_LENGTH_CENTER, MUSCLES

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
