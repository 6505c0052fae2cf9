"""Effects of one subject: parameters with priors, variants, several effects at once, shared alterations."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, Int

from wrapjax.geometry.paths import PathState
from wrapjax.model.alteration import Alteration
from wrapjax.muscle.excitation import EmgSpline

EffectSizes = Float[Array, " parameter"]

#: What the effects of each family have in common, by identifier: a clause for reports, without a full stop.
FAMILIES: dict[str, str] = {
    "emg": "the recorded EMG differs from the excitation of the muscles",
    "activation_and_muscle": "muscles activate or make force in another way than the model's",
    "tendon": "tendons stretch, or pass force between muscles",
    "passive": "tissue resists motion without muscle activity",
    "geometry": "muscle paths, joint centers or joint axes lie elsewhere than in the model",
    "measured_motion": "the recorded motion is not that of the bones",
    "measured_force": "ground forces or segment masses in inverse dynamics are wrong",
    "device": "a device acts on the leg",
    "control": "the person activates muscles that were not recorded, or with another delay",
}


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect; the effect is off where all its parameters are zero.

    Parameters
    ----------
    name
        Name in reports and files, unique within the effect.
    unit
        Unit of the effect size; ``1`` for a ratio.
    prior_sd
        Prior standard deviation, in `unit`: of a normal distribution with mean zero, or of a half-normal
        distribution where `sign` is 1.
    sign
        1 if the effect size cannot be negative, 0 if it can have either sign.
    meaning
        Phrase for reports.
    source
        Source of the prior, with a DOI where there is one.
    limit
        Largest plausible effect size, in `unit`.
    part
        Channel, muscle or joint to which the parameter belongs. The score tests the parameters of each part
        alone as well as all parts together, since an effect is often present in one part only. Empty where
        all parameters belong together.
    usual_sd
        Standard deviation between people without the effect, in `unit`. Every null hypothesis allows for it,
        so that the effect is named only where it is larger.

    Raises
    ------
    ValueError
        If `sign` is neither 0 nor 1, or `prior_sd` is not between 0 and `limit`.
    """

    name: str
    unit: str
    prior_sd: float
    sign: int
    meaning: str
    source: str
    limit: float = np.inf
    part: str = ""
    usual_sd: float = 0.0

    def __post_init__(self):
        if self.sign not in (0, 1):
            raise ValueError(f"{self.name}: a sign is 0 or 1, not {self.sign}")
        if not 0.0 < self.prior_sd <= self.limit:
            raise ValueError(f"{self.name}: expected 0 < prior_sd <= limit")

    @property
    def lower(self) -> float:
        """Smallest effect size."""
        return 0.0 if self.sign else -self.limit

    @property
    def upper(self) -> float:
        """Largest effect size."""
        return self.limit


def scale_prior(
    prior_sd: Float[np.ndarray, "*parameter"] | float,
    factor: float,
    limit: Float[np.ndarray, "*parameter"] | float,
) -> Float[np.ndarray, "*parameter"]:
    """Multiply prior standard deviations by a factor, but keep two standard deviations within the limits.

    A wider prior would count implausible effect sizes as evidence for an effect.
    """
    return np.asarray(np.minimum(factor * np.asarray(prior_sd), 0.5 * np.asarray(limit)))


#: Function from the sizes of one effect to the change of the forward model: a `jax.tree_util.Partial`.
AlterationFunction = Callable[[EffectSizes], Alteration]


class Variant(eqx.Module):
    """One shape of an effect, such as a threshold, a phase or a time constant.

    What distinguishes the variants cannot be a parameter, because it has no influence at effect size zero.
    """

    alteration: AlterationFunction
    #: Distinguishes the variants of an effect in reports; empty where there is one only.
    label: str = eqx.field(static=True, default="")


def _unchanged(effect_sizes: EffectSizes) -> EffectSizes:
    return effect_sizes


def _alteration_by_selected(
    alteration: AlterationFunction,
    selected: Int[Array | np.ndarray, " selected"],
    zero: EffectSizes,
    effect_sizes: Float[Array, " selected"],
) -> Alteration:
    return alteration(zero.at[selected].set(effect_sizes))


class Effect(eqx.Module):
    """Mechanism that the model may leave out, for one subject."""

    #: Identifier in the catalogue and in files.
    id: str = eqx.field(static=True)
    #: One of `FAMILIES`.
    family: str = eqx.field(static=True)
    parameters: tuple[EffectParameter, ...] = eqx.field(static=True)
    #: All variants have the same parameters.
    variants: tuple[Variant, ...]
    #: Whether the effect cannot be present in such a recording, so that it must not be named.
    negative_control: bool = eqx.field(static=True, default=False)
    #: Whether the effect is allowed for in every comparison and never named.
    nuisance: bool = eqx.field(static=True, default=False)
    #: Names and units of the reported quantities, where these are not the parameters themselves.
    reported: tuple[tuple[str, str], ...] = eqx.field(static=True, default=())
    #: Function from effect sizes to the reported quantities.
    to_reported: Callable[[EffectSizes], Float[Array, " quantity"]] = _unchanged

    def __check_init__(self):
        if self.family not in FAMILIES:
            raise ValueError(f"{self.id}: there is no family '{self.family}'")
        names = [parameter.name for parameter in self.parameters]
        if not names or not self.variants or len(set(names)) < len(names):
            raise ValueError(f"{self.id}: expected variants, and parameters with different names")

    @property
    def parts(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the parameters of each part."""
        names = [entry.part for entry in self.parameters]
        return tuple(
            tuple(number for number, part in enumerate(names) if part == name)
            for name in dict.fromkeys(names)
        )

    def only(self, parameters: Sequence[int]) -> Effect:
        """Keep the parameters with these numbers; the others stay at zero."""
        chosen, count = np.asarray(parameters, dtype=int), len(self.parameters)
        if len(chosen) == count:
            return self
        variants = tuple(
            Variant(
                Partial(_alteration_by_selected, variant.alteration, chosen, jnp.zeros(count)), variant.label
            )
            for variant in self.variants
        )
        selected = tuple(self.parameters[number] for number in chosen)
        return Effect(self.id, self.family, selected, variants, self.negative_control)

    def of_size(self, factor: float) -> Effect:
        """Multiply the prior standard deviations by a factor, within the limits; see `scale_prior`."""
        parameters = tuple(
            replace(entry, prior_sd=float(scale_prior(entry.prior_sd, factor, entry.limit)))
            for entry in self.parameters
        )
        return replace(self, parameters=parameters)

    def alteration(self, effect_sizes: EffectSizes, variant: int = 0) -> Alteration:
        """Compute the change of the forward model at these effect sizes."""
        return self.variants[variant].alteration(effect_sizes)

    def reported_values(self, effect_sizes: EffectSizes) -> dict[str, Float[Array, ""]]:
        """Convert effect sizes to the reported quantities, by name, in physical units."""
        names = [name for name, _ in self.reported] or [entry.name for entry in self.parameters]
        return dict(zip(names, self.to_reported(effect_sizes), strict=True))


@dataclass(frozen=True)
class NotTestable:
    """Effect that a recording cannot show, and the reason.

    Parameters
    ----------
    id
        Identifier of the effect.
    reason
        Clause that says what is missing.
    """

    id: str
    reason: str


def split_effect_sizes(
    effect_sizes: Float[Array, "*row amount"], counts: Sequence[int]
) -> tuple[Float[Array, "*row _"], ...]:
    """Split the sizes of several effects into those of each effect, along the last axis."""
    ends = np.cumsum([0, *counts])
    return tuple(effect_sizes[..., first:last] for first, last in itertools.pairwise(ends))


class Effects(eqx.Module):
    """Several effects at once, or none, with all their sizes in one vector.

    Every stage of the model is altered by one effect after the other, in this order.
    """

    members: tuple[Effect, ...]
    #: Number of the variant of each effect; the first one where not given.
    variants: tuple[int, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        if self.variants and len(self.variants) != len(self.members):
            raise ValueError("expected one variant for each effect")

    @property
    def labels(self) -> tuple[str, ...]:
        """Label of each parameter: ``tendon_compliance.strain_at_max_force``."""
        return tuple(f"{effect.id}.{entry.name}" for effect in self.members for entry in effect.parameters)

    @property
    def count(self) -> int:
        """Number of parameters of all effects."""
        return len(self.labels)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of parameters of each effect."""
        return tuple(len(effect.parameters) for effect in self.members)

    @property
    def prior_sd(self) -> Float[np.ndarray, " parameter"]:
        """Prior standard deviation of each parameter."""
        return np.array([entry.prior_sd for entry in self.parameters])

    @property
    def lower(self) -> Float[np.ndarray, " parameter"]:
        """Smallest effect sizes."""
        return np.array([entry.lower for entry in self.parameters])

    @property
    def upper(self) -> Float[np.ndarray, " parameter"]:
        """Largest effect sizes."""
        return np.array([entry.upper for entry in self.parameters])

    @property
    def zero(self) -> Float[Array, " parameter"]:
        """Effect sizes at which all effects are off."""
        return jnp.zeros(self.count)

    @property
    def alteration_functions(self) -> tuple[AlterationFunction, ...]:
        """Function of each effect from its sizes to the change of the forward model."""
        chosen = self.variants or (0,) * len(self.members)
        return tuple(
            effect.variants[number].alteration for effect, number in zip(self.members, chosen, strict=True)
        )

    def alterations(self, effect_sizes: Float[Array, " parameter"]) -> tuple[Alteration, ...]:
        """Compute the changes of the forward model at these effect sizes."""
        return tuple(
            alteration(sizes)
            for alteration, sizes in zip(self.alteration_functions, self.split(effect_sizes), strict=True)
        )

    def split(self, effect_sizes: Float[Array, " parameter"]) -> tuple[Float[Array, " _"], ...]:
        """Split effect sizes into those of each effect."""
        return split_effect_sizes(effect_sizes, self.counts)

    @property
    def parameters(self) -> list[EffectParameter]:
        """Parameters of all effects."""
        return [entry for effect in self.members for entry in effect.parameters]


def add_to_paths(change: PathState, paths: PathState) -> PathState:
    """Add changes to lengths (m), lengthening velocities (m/s) and moment arms (m)."""
    return eqx.tree_at(
        lambda tree: (tree.length, tree.velocity, tree.moment_arm),
        paths,
        (
            paths.length + change.length,
            paths.velocity + change.velocity,
            paths.moment_arm + change.moment_arm,
        ),
    )


def delay_emg(delay: Float[Array, "muscle trial"], emg: EmgSpline) -> EmgSpline:
    """Delay the EMG of each muscle and cycle by an additional time (s)."""
    return replace(emg, lag=delay if emg.lag is None else emg.lag + delay)
