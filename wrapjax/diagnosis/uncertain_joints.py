"""What uncertain places of joints do to joint moments and to the calibrated parameters, wraps included.

Where a joint's center and axes lie is known as far as the markers tell (`wrapjax joints`) or, in a scaled
model, as far as people usually differ from it. An error of such a place changes the moments of inverse
dynamics and the muscles' moment arms. Part of that change is taken up by the calibrated parameters, which
are then wrong, too; the rest stays as an error. All of it is to first order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.calibration.uncertainty.posterior import (
    Posterior,
    moments_and_slopes,
    physical_units,
    posterior,
)
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.definition import FROM_MARKERS, JointPlace
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, Effects
from wrapjax.diagnosis.evidence.linearization import LinearizedModel, mean_emg
from wrapjax.diagnosis.fits.prediction import finite_difference_signatures
from wrapjax.diagnosis.inputs.input import DiagnosisInput, phase_frames
from wrapjax.subject.joint_spread import JointSpread

_Changes = Float[np.ndarray, "change row"]


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
    parameter
        Calibrated parameter that moves farthest, in its standard deviations by noise, as
        ``soleus_l.emg_scale``; empty if all are at bounds.
    parameter_shift
        Standard deviation of that movement, in those by noise.
    """

    joint: str
    quantity: str
    from_markers: bool
    sd: tuple[float, ...]
    moment_sd: Mapping[str, float]
    left_sd: Mapping[str, float]
    parameter: str
    parameter_shift: float


@dataclass(frozen=True)
class ParameterError:
    """How far noise and uncertain joints move a calibrated parameter.

    Parameters
    ----------
    name
        Parameter, as ``soleus_l.emg_scale``, or of a wrap, as ``IL_at_brim_l.radius_factor``.
    unit
        SI unit.
    value
        Calibrated value.
    sd_by_noise
        Standard deviation by noise of the moments and by the priors (`wrapjax.uncertainty`).
    sd_by_joints
        Standard deviation by the places of all joints.
    """

    name: str
    unit: str
    value: float
    sd_by_noise: float
    sd_by_joints: float


@dataclass(frozen=True)
class UncertainJoints:
    """What uncertain places of joints do.

    Parameters
    ----------
    places
        The center and the axes of each joint that change a moment, one at a time.
    moment_sd, left_sd
        As in `JointPlaceError`, of all places together.
    parameters
        Calibrated parameters that are not at a bound, the farthest moved first, in standard deviations by
        noise.
    """

    places: tuple[JointPlaceError, ...]
    moment_sd: Mapping[str, float]
    left_sd: Mapping[str, float]
    parameters: tuple[ParameterError, ...]


def uncertain_joints(
    data: DiagnosisInput, linearized: LinearizedModel, variables: Float[np.ndarray, " variable"]
) -> UncertainJoints | None:
    """Compute what uncertain places of joints do to the moments and to the calibration.

    The calibration is that with all its freedoms: paths that the diagnosis holds move, too.

    Parameters
    ----------
    data
        Input of the diagnosis.
    linearized, variables
        Linearised model, and the calibrated variables about which it was linearised.

    Returns
    -------
    UncertainJoints or None
        None if the recording does not show what joints change, or if its cycles count differently, for which
        the noise of the parameters is not known.
    """
    uncertain = _uncertain_places(data, linearized, variables)
    if not uncertain or np.size(data.calibrated.moment_error) > 1:
        return None
    coordinates, shape = data.calibration_context.coordinates, linearized.residual.shape
    covariance = place_covariance(
        [one.place for one in uncertain],
        np.array([one.sd for one in uncertain]),
        [one.from_markers for one in uncertain],
        data.context.joint_spread,
    )
    calibration = _Calibration.of(data)
    labels = data.calibrated.variables.labels
    noise_sd = calibration.known.deviation()
    free = np.isfinite(noise_sd)

    def propagate(rows: Sequence[int]) -> tuple[dict[str, float], dict[str, float], np.ndarray]:
        root = _root(covariance[np.ix_(rows, rows)])
        changes = np.concatenate(
            [root.T @ variant for variant in _joined([uncertain[row].signatures for row in rows])]
        )
        left, moved = calibration.follow(changes)
        before, after = (_by_coordinate(one.reshape(-1, *shape), coordinates) for one in (changes, left))
        return before, after, np.sqrt(np.sum(moved**2, axis=1))

    places = []
    for joint, quantity in dict.fromkeys((one.joint, one.place.quantity) for one in uncertain):
        rows = [
            row for row, one in enumerate(uncertain) if (one.joint, one.place.quantity) == (joint, quantity)
        ]
        before, after, moved = propagate(rows)
        share = np.divide(moved, noise_sd, out=np.zeros_like(moved), where=free)
        farthest = int(share.argmax())
        places.append(
            JointPlaceError(
                joint=joint,
                quantity=quantity,
                from_markers=any(uncertain[row].from_markers for row in rows),
                sd=tuple(np.sqrt(np.diagonal(covariance)[rows]).tolist()),
                moment_sd=before,
                left_sd=after,
                parameter=labels[farthest] if share[farthest] > 0.0 else "",
                parameter_shift=float(share[farthest]),
            )
        )
    before, after, moved = propagate(range(len(uncertain)))
    offset, scale, units = physical_units(data.calibrated.variables)
    values = offset + scale * calibration.known.solution
    order = sorted(np.flatnonzero(free).tolist(), key=lambda row: -moved[row] / noise_sd[row])
    parameters = tuple(
        ParameterError(
            name=labels[row],
            unit=units[row],
            value=float(values[row]),
            sd_by_noise=float(scale[row] * noise_sd[row]),
            sd_by_joints=float(scale[row] * moved[row]),
        )
        for row in order
    )
    return UncertainJoints(tuple(places), before, after, parameters)


# ---- Places and how sure they are


@dataclass(frozen=True)
class _UncertainPlace:
    """Parameter that is the place of a joint, with what a unit of it changes, N m, by variant."""

    place: JointPlace
    parameter: EffectParameter
    sd: float
    signatures: Mapping[str, Float[np.ndarray, " row"]]

    @property
    def joint(self) -> str:
        return self.place.stem.split("_")[0]

    @property
    def from_markers(self) -> bool:
        return self.parameter.source.startswith(FROM_MARKERS)


def _uncertain_places(
    data: DiagnosisInput, linearized: LinearizedModel, variables: Float[np.ndarray, " variable"]
) -> list[_UncertainPlace]:
    found = []
    for definition in CATALOGUE.values():
        effect = data.calibration_effects.get(definition.id)
        if effect is None or not definition.joint_places:
            continue
        variants = _signatures(effect, data, linearized, variables)
        changed = {
            (place.stem, place.quantity)
            for row, place in enumerate(definition.joint_places)
            if any(variant[row].any() for variant in variants.values())
        }
        for row, (place, entry) in enumerate(zip(definition.joint_places, effect.parameters, strict=True)):
            if (place.stem, place.quantity) in changed:
                sd = entry.prior_sd if effect.nuisance else entry.usual_sd
                rows = {label: variant[row] for label, variant in variants.items()}
                found.append(_UncertainPlace(place, entry, sd, rows))
    return found


def place_covariance(
    places: Sequence[JointPlace],
    sd: Float[np.ndarray, " place"],
    from_markers: Sequence[bool],
    spread: Mapping[str, JointSpread],
) -> Float[np.ndarray, "place place"]:
    """Compute the covariance of places of joints.

    Parameters
    ----------
    places, sd
        Places, and their standard deviations, m or rad.
    from_markers
        Whether markers determine each; the others are independent.
    spread
        Personalised joints, by coordinate, with the correlations between them.

    Returns
    -------
    array
        m^2, m rad and rad^2, of parameters with the signs of the effects.
    """
    correlation = np.eye(len(places))
    owners = [
        next((name for name in spread if known and name.startswith(place.stem)), None)
        for place, known in zip(places, from_markers, strict=True)
    ]
    for row, (first, one) in enumerate(zip(places, owners, strict=True)):
        for column, (second, other) in enumerate(zip(places, owners, strict=True)):
            if row == column or one is None or other is None or other not in spread[one].correlation:
                continue
            value = spread[one].correlation[other][first.row, second.row]
            outward = -1.0 if one.endswith("_l") else 1.0
            correlation[row, column] = value * first.sign(outward) * second.sign(outward)
    return correlation * np.outer(sd, sd)


def _root(covariance: Float[np.ndarray, "place place"]) -> Float[np.ndarray, "place sum"]:
    """Root of a covariance that may be singular, or indefinite by rounding."""
    sd = np.sqrt(np.diagonal(covariance))
    scale = np.where(sd > 0.0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(values.clip(0.0))


# ---- What they change


def _signatures(
    effect: Effect,
    data: DiagnosisInput,
    linearized: LinearizedModel,
    variables: Float[np.ndarray, " variable"],
) -> dict[str, Float[np.ndarray, "parameter row"]]:
    """Look up or compute the signatures of each variant of an effect, N m per unit of each parameter."""
    labels = [variant.label for variant in effect.variants]
    for one in linearized.candidates:
        if one.id == effect.id:
            return dict(zip(labels, one.variants, strict=True))
    problem = data.law.free
    parameters = problem.parameters(jnp.asarray(data.law.with_free_law(variables)))
    recording = data.calibration_recording
    # Like the signatures of candidates: at the mean envelopes of each speed.
    averaged = mean_emg(recording.emg, linearized.speeds)
    frames = phase_frames(data.measured.shape[-1])
    return {
        label: np.asarray(
            finite_difference_signatures(
                problem.curves,
                parameters,
                replace(recording, emg=averaged),
                Effects((effect,), (number,)),
            )
        )[..., frames].reshape(len(effect.parameters), -1)
        for number, label in enumerate(labels)
    }


def _joined(places: Sequence[Mapping[str, Float[np.ndarray, " row"]]]) -> list[_Changes]:
    """Join the variants of places, of which one holds for all, each with the same probability.

    Places with a single variant have it in all.
    """
    labels = dict.fromkeys(label for place in places if len(place) > 1 for label in place) or [None]
    variants = [
        np.stack([place.get(label, np.mean(list(place.values()), axis=0)) for place in places])  # type: ignore[arg-type]
        for label in labels
    ]
    return [variant / np.sqrt(len(variants)) for variant in variants]


@dataclass(frozen=True)
class _Calibration:
    """A calibration that follows changes of measured less predicted moments, to first order.

    Parameters
    ----------
    known
        Posterior about the solution.
    slopes
        Derivatives of the predicted moments by the variables, N m, at the phases of changes.
    weight
        Weight of each squared residual in the cost, 1/(N m)^2.
    """

    known: Posterior
    slopes: Float[np.ndarray, "row variable"]
    weight: float

    @classmethod
    def of(cls, data: DiagnosisInput) -> _Calibration:
        """Linearise the calibration of a diagnosis about its solution."""
        problem, shape = data.calibrated, data.calibrated.measured.shape
        speeds = data.context.speeds[data.plan.calibration]
        known = posterior(problem, data.solver_state, (speeds,))
        # The residuals of the cost are divided by this.
        unit = float(problem.moment_error) * np.sqrt(problem.measured.size)
        slopes = np.asarray(moments_and_slopes(problem, jnp.asarray(known.solution))[1]) * unit
        frames = phase_frames(shape[-1])
        at_phases = slopes.reshape(*shape, -1)[..., frames, :]
        return cls(known, at_phases.reshape(-1, slopes.shape[-1]), shape[-1] / len(frames) / unit**2)

    def follow(self, changes: _Changes) -> tuple[_Changes, Float[np.ndarray, "variable change"]]:
        """Compute what is left of changes of the moments (N m), and how far the variables move."""
        moved = self.known.step(-self.weight * self.slopes.T @ changes.T)
        return changes - (self.slopes @ moved).T, moved


def _by_coordinate(
    changes: Float[np.ndarray, "change cycle coordinate phase"], coordinates: tuple[str, ...]
) -> dict[str, float]:
    squares = np.sum(changes**2, axis=0).mean(axis=(0, 2))
    return dict(zip(coordinates, np.sqrt(squares).tolist(), strict=True))
