"""What an effect is: something that the plain model leaves out, off at zero."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, Int

from wrapjax.model.alteration import Alteration

#: Where an effect can enter, in the order in which a recording becomes moments.
FAMILIES = (
    "measurement",
    "kinematics",
    "geometry",
    "excitation",
    "activation",
    "fiber",
    "tendon",
    "joint",
    "calibration",
)


@dataclass(frozen=True)
class EffectParameter:
    """One amount of an effect: zero is off.

    Parameters
    ----------
    name
        As reports and files call it.
    unit
        Of its value; ``1`` for a ratio.
    prior_sd
        How large it is expected to be, in its unit; of a half-normal distribution where it has a sign.
    sign
        1 where it cannot be negative, 0 where it may be either.
    meaning
        A phrase for reports.
    source
        Where the prior comes from, with a DOI where there is one.
    limit
        Largest amount at which the effect still makes sense.
    part
        Of several things of one kind (channels, muscles, joints) the one it belongs to: as a rule one of
        them is amiss, not all. Empty where all amounts go together.
    """

    name: str
    unit: str
    prior_sd: float
    sign: int
    meaning: str
    source: str
    limit: float = np.inf
    part: str = ""

    def __post_init__(self):
        if self.sign not in (0, 1):
            raise ValueError(f"{self.name}: a sign is 0 or 1, not {self.sign}")
        if not 0.0 < self.prior_sd <= self.limit:
            raise ValueError(f"{self.name}: expected 0 < prior_sd <= limit")

    @property
    def lower(self) -> float:
        """Smallest amount."""
        return 0.0 if self.sign else -self.limit

    @property
    def upper(self) -> float:
        """Largest amount."""
        return self.limit


def resized(
    prior_sd: Float[np.ndarray, "*parameter"] | float,
    factor: float,
    limit: Float[np.ndarray, "*parameter"] | float,
) -> Float[np.ndarray, "*parameter"]:
    """Expect amounts to be so many times as large, but for two standard deviations to stay within limits.

    A prior that is wider would count amounts that make no sense as evidence for an effect.
    """
    return np.asarray(np.minimum(factor * np.asarray(prior_sd), 0.5 * np.asarray(limit)))


#: From amounts, one a parameter, to what is different in the model: a `jax.tree_util.Partial`.
Form = Callable[[Float[Array, " parameter"]], Alteration]


class Variant(eqx.Module):
    """One shape of an effect: a threshold, a phase, a time constant that zero amounts cannot tell."""

    form: Form
    #: Tells it from the effect's other variants; empty where there is one only.
    label: str = eqx.field(static=True, default="")


def _as_they_are(effect_sizes: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
    return effect_sizes


def _placed(
    form: Form,
    places: Int[Array | np.ndarray, " own"],
    nothing: Float[Array, " parameter"],
    effect_sizes: Float[Array, " own"],
) -> Alteration:
    return form(nothing.at[places].set(effect_sizes))


class Effect(eqx.Module):
    """A mechanism that may be missing from the model, for one subject."""

    #: As the catalogue and files call it.
    id: str = eqx.field(static=True)
    #: One of `FAMILIES`.
    family: str = eqx.field(static=True)
    parameters: tuple[EffectParameter, ...] = eqx.field(static=True)
    #: All take the same parameters.
    variants: tuple[Variant, ...]
    #: It must stay quiet: what it does cannot be in such a recording.
    negative_control: bool = eqx.field(static=True, default=False)
    #: Allowed for in every comparison, as it passes for other effects.
    nuisance: bool = eqx.field(static=True, default=False)
    #: Names and units of what is reported in place of the parameters themselves; empty: them.
    reported: tuple[tuple[str, str], ...] = eqx.field(static=True, default=())
    #: From amounts to what is reported, in that order.
    reading: Callable[[Float[Array, " parameter"]], Float[Array, " reading"]] = _as_they_are

    def __check_init__(self):
        if self.family not in FAMILIES:
            raise ValueError(f"{self.id}: there is no family '{self.family}'")
        names = [parameter.name for parameter in self.parameters]
        if not names or not self.variants or len(set(names)) < len(names):
            raise ValueError(f"{self.id}: expected variants, and parameters with names of their own")

    @property
    def parts(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the amounts that belong together, part by part."""
        names = [entry.part for entry in self.parameters]
        return tuple(
            tuple(number for number, own in enumerate(names) if own == name) for name in dict.fromkeys(names)
        )

    def only(self, effect_sizes: Sequence[int]) -> Effect:
        """Keep some amounts, by their numbers; the others stay zero."""
        chosen, count = np.asarray(effect_sizes, dtype=int), len(self.parameters)
        if len(chosen) == count:
            return self
        variants = tuple(
            Variant(Partial(_placed, variant.form, chosen, jnp.zeros(count)), variant.label)
            for variant in self.variants
        )
        parameters = tuple(self.parameters[number] for number in chosen)
        return Effect(self.id, self.family, parameters, variants, self.negative_control)

    def of_size(self, factor: float) -> Effect:
        """Expect amounts so many times as large, within their limits; see `resized`."""
        parameters = tuple(
            replace(entry, prior_sd=float(resized(entry.prior_sd, factor, entry.limit)))
            for entry in self.parameters
        )
        return replace(self, parameters=parameters)

    def alteration(self, effect_sizes: Float[Array, " parameter"], variant: int = 0) -> Alteration:
        """Say what is different in the model at these amounts."""
        return self.variants[variant].form(effect_sizes)

    def readings(self, effect_sizes: Float[Array, " parameter"]) -> dict[str, Float[Array, ""]]:
        """Turn amounts into what is reported, by name, in physical units."""
        names = [name for name, _ in self.reported] or [entry.name for entry in self.parameters]
        return dict(zip(names, self.reading(effect_sizes), strict=True))


@dataclass(frozen=True)
class NotTestable:
    """An effect that this recording cannot show, and why.

    Parameters
    ----------
    id
        Of the effect.
    reason
        A sentence.
    """

    id: str
    reason: str


def split_effect_sizes(
    effect_sizes: Float[Array, "*row amount"], counts: Sequence[int]
) -> tuple[Float[Array, "*row _"], ...]:
    """Cut the amounts of several effects, or rows of them, into each effect's own."""
    ends = np.cumsum([0, *counts])
    return tuple(effect_sizes[..., first:last] for first, last in itertools.pairwise(ends))


class Effects(eqx.Module):
    """Several effects at once, or none, with their amounts in one vector.

    Each stage of the model is altered by one effect after the other, in this order.
    """

    members: tuple[Effect, ...]
    #: Which variant of each; the first ones where not given.
    variants: tuple[int, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        if self.variants and len(self.variants) != len(self.members):
            raise ValueError("expected one variant for each effect")

    @property
    def labels(self) -> tuple[str, ...]:
        """``tendon_compliance.strain_at_max_force``: one an amount."""
        return tuple(f"{effect.id}.{entry.name}" for effect in self.members for entry in effect.parameters)

    @property
    def count(self) -> int:
        """Number of amounts."""
        return len(self.labels)

    @property
    def counts(self) -> tuple[int, ...]:
        """How many amounts each member has."""
        return tuple(len(effect.parameters) for effect in self.members)

    @property
    def prior_sd(self) -> Float[np.ndarray, " parameter"]:
        """Expected size of each amount."""
        return np.array([entry.prior_sd for entry in self.parameters])

    @property
    def lower(self) -> Float[np.ndarray, " parameter"]:
        """Smallest amounts."""
        return np.array([entry.lower for entry in self.parameters])

    @property
    def upper(self) -> Float[np.ndarray, " parameter"]:
        """Largest amounts."""
        return np.array([entry.upper for entry in self.parameters])

    @property
    def zero(self) -> Float[Array, " parameter"]:
        """All off."""
        return jnp.zeros(self.count)

    @property
    def forms(self) -> tuple[Form, ...]:
        """From each effect's amounts to what is different in the model."""
        chosen = self.variants or (0,) * len(self.members)
        return tuple(
            effect.variants[number].form for effect, number in zip(self.members, chosen, strict=True)
        )

    def alterations(self, effect_sizes: Float[Array, " parameter"]) -> tuple[Alteration, ...]:
        """Say what is different in the model at these amounts."""
        return tuple(form(own) for form, own in zip(self.forms, self.split(effect_sizes), strict=True))

    def split(self, effect_sizes: Float[Array, " parameter"]) -> tuple[Float[Array, " _"], ...]:
        """Hand each effect its own amounts."""
        return split_effect_sizes(effect_sizes, self.counts)

    @property
    def parameters(self) -> list[EffectParameter]:
        """One an amount."""
        return [entry for effect in self.members for entry in effect.parameters]
