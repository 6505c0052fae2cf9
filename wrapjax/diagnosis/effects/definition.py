"""Definition of an effect: everything about it that holds for all subjects."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float

from wrapjax.diagnosis.effects.effect import (
    Effect,
    EffectParameter,
    EffectSizes,
    NotTestable,
    Variant,
    add_to_paths,
)
from wrapjax.diagnosis.effects.experiments import Experiment
from wrapjax.diagnosis.inputs.context import Context, MeasuredChange
from wrapjax.diagnosis.inputs.recorded_movement import MomentDerivatives, RecordedMovement
from wrapjax.diagnosis.inputs.recorded_paths import RecordedPaths
from wrapjax.geometry.paths import PathState
from wrapjax.model.alteration import Alteration
from wrapjax.subject.joint_spread import JointSpread

#: Largest plausible error of a personalised joint, in its standard deviations.
_LIMIT_OF_PERSONALISED = 4.0
#: What effects need that act on the measured moments through inverse dynamics.
GROUND_REACTION_FORCES = "ground reaction forces"


@dataclass(frozen=True)
class Requirement:
    """Something that an effect needs of the subject or the recording.

    Parameters
    ----------
    text
        Noun phrase for the documentation.
    unmet
        Function that gives the reason why a subject does not meet the requirement; empty where it does.
    """

    text: str
    unmet: Callable[[Context], str]


@dataclass(frozen=True, kw_only=True)
class RepeatedParameter:
    """Parameter that an effect has once for each channel, muscle, joint or cycle of the subject.

    The other fields are those of `EffectParameter`. Texts hold placeholders (``gain_{channel}``); numbers and
    the unit are None where they differ between the repetitions.

    Parameters
    ----------
    repetitions
        Function that gives, for each repetition, the values of the placeholders and of the fields that are
        None.
    prior
        Words on the prior standard deviation for the documentation, where `prior_sd` is None.
    """

    repetitions: Callable[[Context], Iterable[Mapping[str, Any]]]
    name: str
    unit: str | None = None
    prior_sd: float | None = None
    sign: int
    meaning: str
    source: str
    limit: float | None = None
    part: str = ""
    usual_sd: float = 0.0
    prior: str = ""

    def of(self, context: Context) -> tuple[EffectParameter, ...]:
        """Give the parameters of a subject."""
        return tuple(self._repetition(values) for values in self.repetitions(context))

    def _repetition(self, values: Mapping[str, Any]) -> EffectParameter:
        entries: dict[str, Any] = {}
        for field in fields(EffectParameter):
            entry = getattr(self, field.name)
            if entry is None:
                entry = values[field.name]
            entries[field.name] = entry.format(**values) if isinstance(entry, str) else entry
        return EffectParameter(**entries)


@dataclass(frozen=True)
class JointPlace:
    """Place of a joint in its parent body, to which a parameter is an error.

    Parameters
    ----------
    stem
        Start of the names of the joint's coordinates.
    quantity
        ``translation`` along, or ``orientation`` about, the axis.
    axis
        0, 1 or 2 for x, y or z of the parent body.
    """

    stem: str
    quantity: str
    axis: int

    @property
    def row(self) -> int:
        """Number among the three translations and the three orientations of the joint."""
        return self.axis + (3 if self.quantity == "orientation" else 0)

    def sign(self, outward: float) -> float:
        """Give the sign of a movement along or about the axis that is a positive effect size.

        Parameters
        ----------
        outward
            1 for the right leg, -1 for the left.
        """
        # On a right leg, outward is clockwise seen from above, and the outer end of an axis goes up
        # counterclockwise seen from behind; a front end always goes up about the direction to the right.
        if self.quantity == "translation":
            return outward if self.axis == 2 else 1.0
        return 1.0 if self.axis == 2 else -outward


#: Beginning of the source of the priors of a joint's place that markers determine.
FROM_MARKERS = "joint personalised from markers"


def narrowed(
    parameter: EffectParameter, place: JointPlace, spread: Mapping[str, JointSpread]
) -> EffectParameter:
    """Narrow a parameter's priors to what markers leave open of the joint's place.

    Parameters
    ----------
    parameter
        Parameter with the priors of a scaled model.
    place
        Place of the joint.
    spread
        Standard deviations of personalised joints, by coordinate.

    Returns
    -------
    EffectParameter
        Parameter with prior and usual standard deviation no larger than that of the joint's place, and limits
        of four of these; unchanged if the joint was not personalised, or is less certain than after scaling.
    """
    joint = next((joint for name, joint in spread.items() if name.startswith(place.stem)), None)
    sd = None if joint is None else getattr(joint, place.quantity)[place.axis]
    if sd is None or sd >= parameter.prior_sd:
        return parameter
    return replace(
        parameter,
        prior_sd=sd,
        usual_sd=min(parameter.usual_sd, sd),
        limit=min(parameter.limit, _LIMIT_OF_PERSONALISED * sd),
        source=f"{FROM_MARKERS}; of a scaled model: {parameter.source}",
    )


@dataclass(frozen=True, kw_only=True)
class EffectDefinition:
    """Everything about an effect that holds for all subjects.

    Parameters
    ----------
    id
        Identifier in the catalogue and in files.
    meaning
        What differs in the person or the recording: a clause for reports, without a full stop.
    family
        One of `FAMILIES`: what kind of thing differs from the model.
    parameters
        Parameters with priors, in the order of the effect sizes.
    variants
        Function that gives the variants for a subject. None for an effect that is nothing but a change of the
        measured moments, and of the paths where these are known to change: it has one variant for each entry
        of its `moment_derivatives`.
    requirements
        What the effect needs, in the order in which it is checked; the first unmet requirement gives the
        reason for which an effect is not testable.
    experiment
        Experiment that shows by itself whether the effect is present; None if there is none.
    in_one_condition
        Whether an effect that changes nothing but the measured moments may also be present in one recording
        or at one walking speed only (`Context.conditions`): each of these is a further variant.
    shared_by_conditions
        Whether the effect is the same in all conditions of one person, as it concerns the body's muscle paths
        or calibrated parameters: it does not explain what differs between two.
    negative_control, nuisance, reported
        See `Effect`.
    joint_places
        For each parameter that is an error in the place of a joint: the place. Where the joint was
        personalised from markers, the parameter's priors are no wider than what these leave open.
    to_reported
        Function that gives, for a subject, the function from effect sizes to the reported quantities. None
        where the parameters themselves are reported.
    moment_derivatives
        Function that computes the change of the measured moments per unit of each parameter, by label of the
        variant, where ground reaction forces were recorded. A positive effect size is an error that the
        laboratory's input of inverse dynamics has.
    path_derivatives
        Function that computes the change of the recorded paths per unit of each parameter, by label of the
        variant, from the recorded paths to those that the person's muscles had; leaves lead with ``muscle
        parameter``. A variant that it leaves out changes moments alone.
    """

    id: str
    meaning: str
    family: str
    parameters: tuple[EffectParameter | RepeatedParameter, ...]
    variants: Callable[[Context], tuple[Variant, ...]] | None = None
    requirements: tuple[Requirement, ...] = ()
    experiment: Experiment | None = None
    in_one_condition: bool = False
    shared_by_conditions: bool = False
    negative_control: bool = False
    nuisance: bool = False
    reported: tuple[tuple[str, str], ...] = ()
    joint_places: tuple[JointPlace, ...] = ()
    to_reported: Callable[[Context], Callable[[EffectSizes], Float[Array, " quantity"]]] | None = None
    moment_derivatives: Callable[[RecordedMovement], Mapping[str, MomentDerivatives]] | None = None
    path_derivatives: Callable[[RecordedPaths], Mapping[str, PathState]] | None = None

    @property
    def needs(self) -> tuple[str, ...]:
        """What the effect needs of the subject and the recording: noun phrases."""
        own = tuple(requirement.text for requirement in self.requirements)
        return own if self.variants is not None else (GROUND_REACTION_FORCES, *own)

    def build(self, context: Context) -> Effect | NotTestable:
        """Build the effect for a subject, or give the reason why its recording cannot show it."""
        for requirement in self.requirements:
            if reason := requirement.unmet(context):
                return NotTestable(self.id, reason)
        variants = self._measured_variants(context) if self.variants is None else self.variants(context)
        if not variants:
            return NotTestable(self.id, context.no_measured_changes)
        reported = {} if self.to_reported is None else {"to_reported": self.to_reported(context)}
        return Effect(
            id=self.id,
            family=self.family,
            parameters=self.parameters_of(context),
            variants=variants,
            negative_control=self.negative_control,
            nuisance=self.nuisance,
            reported=self.reported,
            **reported,
        )

    def parameters_of(self, context: Context) -> tuple[EffectParameter, ...]:
        """Give the parameters of the effect for a subject."""
        parameters = tuple(
            parameter
            for entry in self.parameters
            for parameter in (entry.of(context) if isinstance(entry, RepeatedParameter) else (entry,))
        )
        if not self.joint_places:
            return parameters
        return tuple(
            narrowed(parameter, place, context.joint_spread)
            for parameter, place in zip(parameters, self.joint_places, strict=True)
        )

    def _measured_variants(self, context: Context) -> tuple[Variant, ...]:
        paths = context.path_changes.get(self.id, {})
        conditions = context.conditions if self.in_one_condition else {}
        variants = []
        for label, change in context.measured_changes.get(self.id, {}).items():
            variants.append(Variant(Partial(_change_measurement, change, paths.get(label)), label))
            for condition, cycles in conditions.items():
                in_cycles = Partial(_change_cycles, change, jnp.asarray(cycles))
                variants.append(
                    Variant(Partial(_change_measurement, in_cycles, None), f"{label} {condition}".strip())
                )
        return tuple(variants)


def _change_cycles(
    change: MeasuredChange, cycles: Bool[Array, " trial"], effect_sizes: EffectSizes
) -> Float[Array, "trial coordinate frame"]:
    return change(effect_sizes) * cycles[:, None, None]


def _change_measurement(
    change: MeasuredChange, derivatives: PathState | None, effect_sizes: EffectSizes
) -> Alteration:
    if derivatives is None:
        return Alteration(moment=change(effect_sizes))
    by_sizes = jax.tree.map(lambda leaf: jnp.einsum("p,mp...->m...", effect_sizes, leaf), derivatives)
    return Alteration(moment=change(effect_sizes), paths=Partial(add_to_paths, by_sizes))
