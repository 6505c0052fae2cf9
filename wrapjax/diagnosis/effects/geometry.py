"""Where muscles run: cylinders and attachments in other places than the model has them."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import Context, PathChanges
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.geometry.paths import PathState
from wrapjax.model.alteration import Alteration

#: No amount may be more than so many prior deviations.
_MOST = 4.0


def wrap_surface(context: Context) -> Effect | NotTestable:
    """Move, turn and resize the cylinders that muscles wrap round, each alike for all its muscles."""
    if context.wraps is None:
        return NotTestable(
            "wrap_surface", "how paths follow their cylinders is not known, or none is touched"
        )
    return _of_changes("wrap_surface", context.wraps, "of a wrapping cylinder", "box of the cylinder")


def muscle_attachment(context: Context) -> Effect | NotTestable:
    """Move where muscles begin and end; length, rate and moment arms follow together."""
    if context.attachments is None:
        return NotTestable("muscle_attachment", "how paths follow their ends is not known")
    source = "moment arms that change by 4 to 12 mm when paths are personalised"
    return _of_changes("muscle_attachment", context.attachments, "of a muscle's end", source)


def _of_changes(id: str, changes: PathChanges, what: str, source: str) -> Effect:
    parameters = tuple(
        EffectParameter(name, unit, sd, 0, f"displacement {what}", source, _MOST * sd, name.rsplit(".", 1)[0])
        for name, unit, sd in zip(changes.names, changes.units, changes.prior_sd, strict=True)
    )
    return Effect(id, "geometry", parameters, (Variant(Partial(_moved, changes)),))


def _moved(changes: PathChanges, effect_sizes: Float[Array, " parameter"]) -> Alteration:
    places = jnp.asarray(changes.places)
    own = jnp.where(places >= 0, effect_sizes[places], 0.0)
    changed, unchanged = changes.paths(own), changes.paths(jnp.zeros_like(own))
    return Alteration(paths=Partial(added_to_paths, jax.tree.map(jnp.subtract, changed, unchanged)))


def added_to_paths(change: PathState, paths: PathState) -> PathState:
    """Add to lengths, rates and moment arms."""
    return eqx.tree_at(
        lambda tree: (tree.length, tree.velocity, tree.moment_arm),
        paths,
        (
            paths.length + change.length,
            paths.velocity + change.velocity,
            paths.moment_arm + change.moment_arm,
        ),
    )
