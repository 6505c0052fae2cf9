"""Effects on muscle paths: wrapping surfaces and attachments in other places than in the model."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
from jax.tree_util import Partial

from wrapjax.diagnosis.effects.definition import EffectDefinition, RepeatedParameter, Requirement
from wrapjax.diagnosis.effects.effect import EffectSizes, Variant, add_to_paths
from wrapjax.diagnosis.effects.experiments import PATHS_BY_ULTRASOUND
from wrapjax.diagnosis.inputs.context import PathChanges
from wrapjax.model.alteration import Alteration

#: Largest effect size, in prior standard deviations.
_LIMIT_IN_SD = 4.0


def _each_parameter(changes: PathChanges | None, element: str, quantity: str) -> Iterable[dict[str, Any]]:
    """Give the parameters of path changes, with names for the placeholders of both parts of their names."""
    assert changes is not None, "required before parameters are built"
    for name, unit, prior_sd in zip(changes.names, changes.units, changes.prior_sd, strict=True):
        yield {
            **dict(zip((element, quantity), name.rsplit(".", 1), strict=True)),
            "unit": unit,
            "prior_sd": prior_sd,
            "limit": _LIMIT_IN_SD * prior_sd,
        }


def _variants(changes: PathChanges | None) -> tuple[Variant, ...]:
    assert changes is not None, "required before variants are built"
    return (Variant(Partial(_change_paths, changes)),)


def _change_paths(changes: PathChanges, effect_sizes: EffectSizes) -> Alteration:
    places = jnp.asarray(changes.places)
    by_muscle = jnp.where(places >= 0, effect_sizes[places], 0.0)
    return Alteration(paths=Partial(add_to_paths, changes.by_muscle(by_muscle)))


# A wrap is the same for all its muscles.
WRAP_SURFACE = EffectDefinition(
    id="wrap_surface",
    meaning="surfaces that muscles wrap round have another place, orientation or size",
    family="geometry",
    requirements=(
        Requirement(
            "a wrapping surface that a muscle touches, and paths that the exact engine computes",
            lambda context: (
                "how paths follow their surfaces is not known, or none is touched"
                if context.wraps is None
                else ""
            ),
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=lambda context: _each_parameter(context.wraps, "wrap", "wrap_parameter"),
            name="{wrap}.{wrap_parameter}",
            sign=0,
            meaning="displacement or factor of size of a wrapping surface",
            source="box of the surface",
            part="{wrap}",
            prior="from the bounds of the wrap parameter; limits 4 times as large",
        ),
    ),
    variants=lambda context: _variants(context.wraps),
    shared_by_conditions=True,
    experiment=PATHS_BY_ULTRASOUND,
)

# Length, lengthening velocity and moment arms change together.
MUSCLE_ATTACHMENT = EffectDefinition(
    id="muscle_attachment",
    meaning="muscles begin or end elsewhere on the bones",
    family="geometry",
    requirements=(
        Requirement(
            "paths that the exact engine computes",
            lambda context: "how paths follow their ends is not known" if context.attachments is None else "",
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=lambda context: _each_parameter(context.attachments, "muscle", "end"),
            name="{muscle}.{end}",
            sign=0,
            meaning="displacement of a muscle's end",
            source="moment arms that change by 4 to 12 mm when paths are personalised",
            part="{muscle}",
            prior="0.005 m; limits 4 times as large",
        ),
    ),
    variants=lambda context: _variants(context.attachments),
    shared_by_conditions=True,
    experiment=PATHS_BY_ULTRASOUND,
)
