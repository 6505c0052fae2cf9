"""True parameters of the virtual person's muscles and wrapping cylinders, to be recovered by calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.datasets.virtual_person.anatomy import COORDINATES, CYLINDERS
from wrapjax.datasets.virtual_person.gait import CHANNELS
from wrapjax.datasets.virtual_person.leg import FIBER_LENGTH_CENTER, MUSCLES, on_side
from wrapjax.geometry.exact_paths.engine import GEODESIC, PARITY, ExactPaths, PosedPath, wrap_at_samples
from wrapjax.geometry.exact_paths.wrapped_paths import barriers_around
from wrapjax.geometry.exact_paths.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.geometry.surrogates.wrap_bounds import usable_samples
from wrapjax.io.files import write_json
from wrapjax.io.json_and_arrays import load_json
from wrapjax.osim.model import describe_model

#: File of the true parameters in the folder of a virtual subject.
TRUE_PARAMETERS_FILE = "truth.json"

# Center and half width of the range of each quantity. Chosen here, well inside the bounds of a calibration;
# delays after Cavanagh and Komi 1979, doi:10.1007/BF00431022.
_DELAY_S = (0.055, 0.025)
_ACTIVATION_TIME_S = (0.0175, 0.0075)
_NONLINEARITY = (0.10, 0.10)
_SCALE_FACTOR = (1.0, 0.15)
_FIBER_FACTOR = (1.0, 0.10)
#: Center of the normalised fiber length over the mean gait cycle.
_FIBER_CENTER = (FIBER_LENGTH_CENTER - 0.01, 0.03)
#: Largest relative change of tendon slack lengths.
_SLACK_LIMIT = 0.10
#: Weight of the random number that muscles of one channel share, against each muscle's own: such muscles are
#: alike.
_SHARED_WEIGHT = 0.7

#: Largest change of each wrap parameter at a spread of one (m, rad, radius factor). Chosen here: within the
#: narrowest bounds of a calibration.
LARGEST_CHANGE = np.array([5e-3, 5e-3, 5e-3, np.radians(10.0), np.radians(10.0), 0.1])
#: Number of random placements of each cylinder; the first is usually acceptable.
_DRAWS = 24
# Largest difference between OpenSim's path length and the shortest one (m) in excess of that with the nominal
# cylinder: larger differences come from defects of OpenSim's wrapping.
_LARGEST_EXCESS = 5e-4


@dataclass(frozen=True)
class TrueParameters:
    """True parameters of a virtual leg: one value per muscle, and the displaced wrapping cylinders.

    Parameters
    ----------
    muscles
        Names of the muscles, channel by channel, in the order of a subject's muscles.
    electromechanical_delay, activation_time_constant
        Delay and time constant, s.
    activation_nonlinearity, emg_scale
        Dimensionless; the scale is the excitation where the recorded channel is 1.
    optimal_fiber_length, tendon_slack_length
        Lengths, m.
    wraps
        Wrap parameters (`WRAP_PARAMETERS`) of the cylinders that differ from the model, by wrap.
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
        """Write the parameters to `TRUE_PARAMETERS_FILE` in a folder."""
        columns = {name: getattr(self, name) for name in parameter_names()}
        per_muscle = {
            muscle: {name: values[row] for name, values in columns.items()}
            for row, muscle in enumerate(self.muscles)
        }
        per_wrap = {
            name: dict(zip(WRAP_PARAMETERS, values, strict=True)) for name, values in self.wraps.items()
        }
        content = {"schema": 1, "units": "SI", "muscles": per_muscle, "wraps": per_wrap}
        write_json(Path(folder) / TRUE_PARAMETERS_FILE, content)


def parameter_names() -> tuple[str, ...]:
    """List the muscle parameters of `TrueParameters`, by their names in the model's parameter tree."""
    return tuple(entry.name for entry in fields(TrueParameters) if entry.name not in ("muscles", "wraps"))


def read_true_parameters(folder: Path) -> TrueParameters:
    """Read the true parameters of a virtual subject from its folder."""
    content = load_json(Path(folder) / TRUE_PARAMETERS_FILE)
    per_muscle = content["muscles"]
    columns = {name: np.array([entry[name] for entry in per_muscle.values()]) for name in parameter_names()}
    wraps = {
        name: np.array([values[parameter] for parameter in WRAP_PARAMETERS])
        for name, values in content.get("wraps", {}).items()
    }
    return TrueParameters(muscles=tuple(per_muscle), **columns, wraps=wraps)


def draw_true_parameters(generator: np.random.Generator) -> TrueParameters:
    """Draw random true parameters of a right leg.

    Delays lie between 30 and 80 ms, activation time constants between 10 and 25 ms, nonlinearities between 0
    and 0.2, EMG scales within 15 % of the usual ones, fiber and slack lengths within 10 % of the model's.
    Slack lengths are adjusted to the fibers so that these stay in their operating range: a tendon 10 % longer
    would take up most of a short fiber's length.
    """
    muscles = tuple(name for channel in CHANNELS.values() for name in channel.scales)
    by_name = {muscle.name: muscle for muscle in MUSCLES}
    chosen = [by_name[name] for name in muscles]
    usual_scale = np.array([scale for channel in CHANNELS.values() for scale in channel.scales.values()])
    channel_of = np.repeat(np.arange(len(CHANNELS)), [len(channel.scales) for channel in CHANNELS.values()])

    def draw(limits: tuple[float, float]) -> Float[np.ndarray, " muscle"]:
        shared = generator.uniform(-1.0, 1.0, len(CHANNELS))[channel_of]
        individual = generator.uniform(-1.0, 1.0, len(muscles))
        return limits[0] + limits[1] * (_SHARED_WEIGHT * shared + (1.0 - _SHARED_WEIGHT) * individual)

    fiber = np.array([muscle.optimal_fiber_length for muscle in chosen])
    slack = np.array([muscle.tendon_slack_length for muscle in chosen])
    projection = np.cos([muscle.pennation_angle for muscle in chosen])
    true_fiber = fiber * draw(_FIBER_FACTOR)
    # The slack length at which the path's mean length places the fiber at the drawn center.
    true_slack = slack + (FIBER_LENGTH_CENTER * fiber - draw(_FIBER_CENTER) * true_fiber) * projection
    return TrueParameters(
        muscles=muscles,
        electromechanical_delay=draw(_DELAY_S),
        activation_time_constant=draw(_ACTIVATION_TIME_S),
        activation_nonlinearity=draw(_NONLINEARITY),
        emg_scale=usual_scale * draw(_SCALE_FACTOR),
        optimal_fiber_length=true_fiber,
        tendon_slack_length=np.clip(true_slack, (1.0 - _SLACK_LIMIT) * slack, (1.0 + _SLACK_LIMIT) * slack),
    )


def draw_other_leg(right: TrueParameters, generator: np.random.Generator) -> TrueParameters:
    """Draw random true parameters of the left leg of a person whose right leg is given.

    Delays and EMG scales are independent. Activation constants and lengths are those of the right leg.
    """
    independent = draw_true_parameters(generator)
    return replace(
        right,
        muscles=tuple(on_side(name, "l") for name in right.muscles),
        electromechanical_delay=independent.electromechanical_delay,
        emg_scale=independent.emg_scale,
    )


def draw_wraps(
    generator: np.random.Generator,
    model_file: Path,
    angles: Float[np.ndarray, "cycle frame coordinate"],
    spread: float,
    side: str = "r",
) -> dict[str, Float[np.ndarray, " wrap_parameter"]]:
    """Draw random placements of the wrapping cylinders.

    Parameters
    ----------
    generator
        Random generator; the number of draws does not depend on which placements are accepted.
    model_file
        Model of the virtual leg with nominal cylinders.
    angles
        Joint angles of the recorded cycles, rad, columns as `COORDINATES`.
    spread
        Largest change of every parameter as a multiple of `LARGEST_CHANGE`; changes are uniform.
    side
        Side of the leg, ``l`` or ``r``.

    Returns
    -------
    dict of Array
        Parameters (`WRAP_PARAMETERS`) of each cylinder, by its name: the first placement at which the paths
        of all its muscles touch it, are continuous, and stay within the barriers of a calibration.

    Raises
    ------
    ValueError
        If no placement of a cylinder is acceptable: the spread is too large.
    """
    model = describe_model(model_file)
    coordinates = tuple(on_side(name, side) for name in COORDINATES)
    draws = generator.uniform(-1.0, 1.0, (len(CYLINDERS), _DRAWS, len(WRAP_PARAMETERS)))
    users = {
        cylinder.name: [muscle.name for muscle in MUSCLES if muscle.cylinder == cylinder.name]
        for cylinder in CYLINDERS
    }
    # All muscles together, so that a single program is compiled.
    wrapped = [on_side(muscle, side) for muscles in users.values() for muscle in muscles]
    frames = angles.shape[1]
    posed = ExactPaths(model, wrapped, coordinates).posed(angles.reshape(-1, len(coordinates)))
    wraps = {}
    for cylinder, placements in zip(CYLINDERS, NOMINAL + spread * LARGEST_CHANGE * draws, strict=True):
        name = on_side(cylinder.name, side)
        paths = [posed[on_side(muscle, side)] for muscle in users[cylinder.name]]
        usable = np.all([_acceptable(path, placements, frames) for path in paths], axis=0)
        if not usable.any():
            raise ValueError(
                f"no usable placement was found for cylinder '{name}': a wrap spread of {spread} is too large"
            )
        wraps[name] = placements[usable.argmax()]
    return wraps


def _acceptable(
    path: PosedPath, samples: Float[np.ndarray, "sample wrap_parameter"], frames: int
) -> Bool[np.ndarray, " sample"]:
    """Find placements at which the paths are usable.

    The shortest path has to be usable and within the barriers of a calibration, which could not find a
    placement beyond them; OpenSim's path, by which the recordings are simulated, has to follow the shortest.
    """
    moved = np.concatenate([NOMINAL[None], samples])[:, None]
    shortest, parity = (wrap_at_samples(path, moved, wrapping) for wrapping in (GEODESIC, PARITY))
    difference = np.abs(parity.length - shortest.length).max(axis=1)
    barriers = barriers_around(jax.tree.map(lambda leaf: leaf[:1], shortest), frames)
    barriers = jax.tree.map(lambda leaf: leaf[0], barriers)
    proximity = jax.vmap(barriers.proximity)(shortest.clearances[1:], shortest.on_surface[1:])
    within = np.isfinite(np.asarray(proximity)).all(axis=1)
    return usable_samples(path, 0, samples) & within & (difference[1:] <= difference[0] + _LARGEST_EXCESS)
