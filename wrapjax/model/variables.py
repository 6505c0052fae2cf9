"""Between the parameter tree and the flat vector that a solver moves."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import ModelParameters


class Variables(eqx.Module):
    """The free entries of a parameter tree, scaled to order one.

    A muscle's force depends on that muscle's parameters alone. So every muscle keeps a short vector
    of its own, ``local``, and ``index`` says which variable stands at each place of it. Entries of
    several muscles may point to one variable: that is how parameters are shared.
    """

    base: ModelParameters
    names: tuple[str, ...] = eqx.field(static=True)
    scale: Float[np.ndarray, "muscle local"]
    index: Int[np.ndarray, "muscle local"]
    #: Flat places of each variable in ``index``, one row a muscle that shares it.
    places: Int[np.ndarray, "layer variable"]
    lower: Float[np.ndarray, " variable"]
    upper: Float[np.ndarray, " variable"]
    prior_mean: Float[np.ndarray, " variable"]
    #: One over the prior's standard deviation; 0 where nothing is expected.
    prior_precision: Float[np.ndarray, " variable"]
    #: ``soleus_l.emg_scale``: one a variable.
    labels: tuple[str, ...] = eqx.field(static=True)

    @property
    def count(self) -> int:
        """Number of variables."""
        return len(self.labels)

    def start(self) -> Float[Array, " variable"]:
        """Give the variables of the base parameters, moved inside the bounds."""
        return jnp.clip(self.pack(self.base), self.lower, self.upper)

    def pack(self, parameters: ModelParameters) -> Float[Array, " variable"]:
        """Read the variables off a parameter tree; of a shared one, the last muscle's value."""
        local = jnp.stack([getattr(parameters, name) for name in self.names], axis=-1) / self.scale
        return jnp.zeros(self.count).at[self.index].set(local)

    def unpack(self, variables: Float[Array, " variable"]) -> ModelParameters:
        """Put the variables into the tree."""
        return self.insert(self.base, self.localize(variables), self.scale)

    def localize(self, variables: Float[Array, " variable"]) -> Float[Array, "muscle local"]:
        """Hand every muscle its own variables."""
        return variables[self.index]

    def insert(
        self,
        parameters: ModelParameters,
        local: Float[Array, "*muscle local"],
        scale: Float[Array | np.ndarray, "*muscle local"],
    ) -> ModelParameters:
        """Put local variables into the tree of one muscle, or of all."""
        values = [local[..., place] * scale[..., place] for place in range(len(self.names))]
        return eqx.tree_at(
            lambda tree: [getattr(tree, name) for name in self.names], parameters, replace=values
        )

    def gather(self, blocks: Float[Array, "muscle local row"]) -> Float[Array, "variable row"]:
        """Turn derivatives by local entries into derivatives by variables (chain rule)."""
        flat = blocks.reshape(-1, blocks.shape[-1])
        if len(self.places) == 1:
            return flat[self.places[0]]
        flat = jnp.concatenate([flat, jnp.zeros_like(flat[:1])])
        return sum((flat[layer] for layer in self.places[1:]), start=flat[self.places[0]])


def _places(index: Int[np.ndarray, "muscle local"], count: int) -> Int[np.ndarray, "layer variable"]:
    """Find where each variable stands: its first place, its second, ...; past its last, none."""
    order = np.argsort(index, axis=None, kind="stable")
    owner = index.ravel()[order]
    occurrence = np.arange(len(owner)) - np.searchsorted(owner, owner)
    places = np.full((int(occurrence.max()) + 1, count), index.size)
    places[occurrence, owner] = order
    return places


def free_variables(base: ModelParameters, freedom: Freedom, muscles: Sequence[str]) -> Variables:
    """Lay out the variables of a freedom, all of one muscle after all of another.

    Parameters
    ----------
    base
        Values of what is not freed, and the start of what is.
    freedom
        What may move.
    muscles
        Names, in the order of the tree's leading axis.
    """
    freed = freedom.parameters
    index = np.arange(len(muscles) * len(freed)).reshape(len(muscles), len(freed))
    scale = np.stack([parameter.scale for parameter in freed], axis=-1)

    def flat(name: str) -> Float[np.ndarray, " variable"]:
        return np.stack([getattr(parameter, name) for parameter in freed], axis=-1).ravel()

    return Variables(
        base=base,
        names=tuple(parameter.name for parameter in freed),
        scale=scale,
        index=index,
        places=_places(index, index.size),
        lower=flat("lower") / scale.ravel(),
        upper=flat("upper") / scale.ravel(),
        prior_mean=flat("prior_mean") / scale.ravel(),
        prior_precision=scale.ravel() / flat("prior_sd"),
        labels=tuple(f"{muscle}.{parameter.name}" for muscle in muscles for parameter in freed),
    )
