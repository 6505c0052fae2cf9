"""What uncertain places of joints do to joint moments and to the calibration.

Where a joint's center and axes lie is known as far as the markers tell (`wrapjax joints`) or, in a scaled
model, as far as people usually differ from it. An error of such a place changes the moments of inverse
dynamics and the muscles' moment arms. Part of that change is taken up by the calibrated parameters, which
are then wrong, too; the rest stays as an error. All of it is to first order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.effects.catalogue import DEFINITIONS
from wrapjax.diagnosis.effects.definition import FROM_MARKERS
from wrapjax.diagnosis.effects.effect import Effect, Effects
from wrapjax.diagnosis.input import DiagnosisInput, phase_frames
from wrapjax.diagnosis.linearization import LinearizedModel, mean_emg
from wrapjax.diagnosis.prediction import finite_difference_signatures


@dataclass(frozen=True)
class JointPlaceError:
    """What one standard deviation of the place of a joint does.

    Parameters
    ----------
    joint
        Joint, such as ``knee``.
    quantity
        ``translation`` of its center, or ``orientation`` of its axes.
    from_markers
        Whether the standard deviations are those that markers leave; otherwise those of scaled models.
    sd
        Standard deviation of each parameter, m or rad.
    moment_sd
        Standard deviation of measured less predicted moments, N m, by coordinate: root mean square over
        gait cycles and phases.
    left_sd
        The same after the calibration has followed the change.
    parameter_shift
        Standard deviation of the calibrated parameter that moves farthest, in its prior standard deviations.
    """

    joint: str
    quantity: str
    from_markers: bool
    sd: tuple[float, ...]
    moment_sd: Mapping[str, float]
    left_sd: Mapping[str, float]
    parameter_shift: float


def joint_place_errors(
    data: DiagnosisInput, linearized: LinearizedModel, variables: Float[np.ndarray, " variable"]
) -> tuple[JointPlaceError, ...]:
    """Compute what uncertain places of joints do to the moments and to the calibration.

    Parameters
    ----------
    data
        Input of the diagnosis.
    linearized, variables
        Linearised model, and the calibrated variables about which it was linearised.

    Returns
    -------
    tuple
        One entry for the center and one for the axes of each joint that change a moment, as far as the
        recording shows what they change.
    """
    context, shape = data.calibration_context, linearized.residual.shape
    frames = phase_frames(data.measured.shape[-1])
    errors = np.broadcast_to(np.asarray(data.problem.moment_error), data.problem.measured.shape)[..., frames]
    # As in the prior of the variables, the objective counts in allowable errors of one muscle's quantity.
    precision = len(data.problem.variables.index) / (errors.ravel() ** 2 * errors.size)
    calibrated = linearized.calibrated.reshape(-1, linearized.residual.size)
    found = []
    for definition in DEFINITIONS:
        effect = data.calibration_effects.get(definition.id)
        if effect is None or not definition.joint_places:
            continue
        variants = _signatures(effect, data, linearized, variables)
        for stem, quantity in dict.fromkeys(
            (place.stem, place.quantity) for place in definition.joint_places
        ):
            rows = [
                number
                for number, place in enumerate(definition.joint_places)
                if (place.stem, place.quantity) == (stem, quantity)
            ]
            entries = [effect.parameters[row] for row in rows]
            sd = np.array([entry.prior_sd if effect.nuisance else entry.usual_sd for entry in entries])
            # One variant holds, each with the same probability.
            changes = np.concatenate([sd[:, None] * variant[rows] for variant in variants])
            changes /= np.sqrt(len(variants))
            if not changes.any():
                continue
            left, moved = after_calibration(changes, calibrated, precision)
            shift = np.sqrt(np.sum((linearized.prior_root @ moved) ** 2, axis=1)) / linearized.parameter_sd
            found.append(
                JointPlaceError(
                    joint=stem.split("_")[0],
                    quantity=quantity,
                    from_markers=any(entry.source.startswith(FROM_MARKERS) for entry in entries),
                    sd=tuple(sd.tolist()),
                    moment_sd=_by_coordinate(changes.reshape(-1, *shape), context.coordinates),
                    left_sd=_by_coordinate(left.reshape(-1, *shape), context.coordinates),
                    parameter_shift=float(shift.max()),
                )
            )
    return tuple(found)


def after_calibration(
    changes: Float[np.ndarray, "change row"],
    calibrated: Float[np.ndarray, "sum row"],
    precision: Float[np.ndarray, " row"],
) -> tuple[Float[np.ndarray, "change row"], Float[np.ndarray, "sum change"]]:
    """Let a calibration follow changes of the moments, to first order.

    Parameters
    ----------
    changes
        Changes of measured less predicted moments, N m.
    calibrated
        Changes of the predicted moments by one prior standard deviation of independent sums of the calibrated
        variables, N m.
    precision
        Weight of each squared residual beside the squared sums, 1/(N m)^2.

    Returns
    -------
    left, moved
        What is left of the changes, N m; and the sums, in prior standard deviations.
    """
    weighted = calibrated * precision
    moved = np.linalg.solve(np.eye(len(calibrated)) + weighted @ calibrated.T, weighted @ changes.T)
    return changes - moved.T @ calibrated, moved


def _signatures(
    effect: Effect,
    data: DiagnosisInput,
    linearized: LinearizedModel,
    variables: Float[np.ndarray, " variable"],
) -> list[Float[np.ndarray, "parameter row"]]:
    """Look up or compute the signatures of each variant of an effect, N m per unit of each parameter."""
    for one in linearized.candidates:
        if one.id == effect.id:
            return list(one.variants)
    problem = data.law.free
    parameters = problem.parameters(jnp.asarray(data.law.with_free_law(variables)))
    recording = data.calibration_recording
    # Like the signatures of candidates: at the mean envelopes of each speed.
    averaged = mean_emg(recording.emg, linearized.speeds)
    frames = phase_frames(data.measured.shape[-1])
    return [
        np.asarray(
            finite_difference_signatures(
                problem.curves,
                parameters,
                replace(recording, emg=averaged),
                Effects((effect,), (number,)),
            )
        )[..., frames].reshape(len(effect.parameters), -1)
        for number in range(len(effect.variants))
    ]


def _by_coordinate(
    changes: Float[np.ndarray, "change cycle coordinate phase"], coordinates: tuple[str, ...]
) -> dict[str, float]:
    squares = np.sum(changes**2, axis=0).mean(axis=(0, 2))
    return dict(zip(coordinates, np.sqrt(squares).tolist(), strict=True))
