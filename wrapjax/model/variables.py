"""Between the parameter tree and the flat vector that a solver moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import ModelParameters, with_path_modes


class Variables(eqx.Module):
    """The free entries of a parameter tree, scaled to order one.

    A muscle's force depends on that muscle's parameters alone. So every muscle keeps a short vector
    of its own, ``local``, and ``index`` says which variable stands at each place of it. Entries of
    several muscles may point to one variable: that is how parameters are shared.
    """

    base: ModelParameters
    #: The free leaves of one number a muscle, at the first local places.
    names: tuple[str, ...] = eqx.field(static=True)
    #: How many synergy weights follow them; 0 where every muscle has a channel.
    weights: int = eqx.field(static=True)
    #: How many modes of its path follow these; 0 where paths are held.
    modes: int = eqx.field(static=True)
    scale: Float[np.ndarray, "muscle local"]
    #: Past the last variable where an entry is held.
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

    @property
    def nonpath_count(self) -> int:
        """Number of a muscle's local places before the modes of its path: all that acts through time."""
        return len(self.names) + self.weights

    def start(self) -> Float[Array, " variable"]:
        """Give the variables of the base parameters, moved inside the bounds."""
        return jnp.clip(self.pack(self.base), self.lower, self.upper)

    @eqx.filter_jit
    def pack(self, parameters: ModelParameters) -> Float[Array, " variable"]:
        """Read the variables off a parameter tree; of a shared one, the last muscle's value.

        The tree may be one whose paths were held, and that has no modes.
        """
        whole = with_path_modes(parameters, self.modes)
        return jnp.zeros(self.count + 1).at[self.index].set(self._local(whole))[:-1]

    @eqx.filter_jit
    def unpack(self, variables: Float[Array, " variable"]) -> ModelParameters:
        """Put the variables into the tree."""
        values = self.localize(variables) * self.scale
        tree = self.insert(self.base, values[:, : self.nonpath_count])
        if not self.modes:
            return tree
        return eqx.tree_at(lambda tree: tree.path_changes, tree, values[:, self.nonpath_count :])

    def localize(self, variables: Float[Array, " variable"]) -> Float[Array, "muscle local"]:
        """Hand every muscle its own variables; what is held has its base value."""
        held = self.index == self.count
        return jnp.where(held, self._local(self.base), jnp.append(variables, 0.0)[self.index])

    def _local(self, parameters: ModelParameters) -> Float[Array, "muscle local"]:
        single = jnp.stack([getattr(parameters, name) for name in self.names], axis=-1)
        parts = [single, parameters.path_changes[:, : self.modes]]
        if parameters.synergy_weights is not None:
            parts.insert(1, parameters.synergy_weights[:, : self.weights])
        return jnp.concatenate(parts, axis=-1) / self.scale

    def insert(self, parameters: ModelParameters, values: Float[Array, "*muscle single"]) -> ModelParameters:
        """Put values of the single parameters, in their units, into the tree of one muscle or of all."""
        leaves = [values[..., place] for place in range(len(self.names))]
        if self.weights:
            leaves.append(values[..., len(self.names) :])
        names = (*self.names, *(["synergy_weights"] if self.weights else []))
        return eqx.tree_at(lambda tree: [getattr(tree, name) for name in names], parameters, replace=leaves)

    def gather(self, blocks: Float[Array, "muscle local row"]) -> Float[Array, "variable row"]:
        """Turn derivatives by local entries into derivatives by variables (chain rule)."""
        flat = blocks.reshape(-1, blocks.shape[-1])
        if len(self.places) == 1:
            return flat[self.places[0]]
        flat = jnp.concatenate([flat, jnp.zeros_like(flat[:1])])
        return sum((flat[layer] for layer in self.places[1:]), start=flat[self.places[0]])

    def assemble(
        self,
        own: Float[Array, "muscle local local"],
        groups: Mapping[tuple[int, ...], Float[Array, "_ _"]] = MappingProxyType({}),
    ) -> Float[Array, "variable variable"]:
        """Turn second derivatives by local entries into those by variables.

        Parameters
        ----------
        own
            Of every muscle by its own entries.
        groups
            Of muscles by the entries of all of them, by their numbers.
        """
        rows = [jnp.repeat(self.index, self.index.shape[1], axis=1).ravel()]
        columns = [jnp.tile(self.index, (1, self.index.shape[1])).ravel()]
        for members in groups:
            index = self.index[np.array(members)].ravel()
            rows.append(jnp.repeat(index, len(index)))
            columns.append(jnp.tile(index, len(index)))
        values = jnp.concatenate([own.ravel(), *(block.ravel() for block in groups.values())])
        # All at once: each scatter would fill a matrix of its own first.
        total = jnp.zeros((self.count + 1, self.count + 1))
        return total.at[jnp.concatenate(rows), jnp.concatenate(columns)].add(values)[:-1, :-1]


def _places(index: Int[np.ndarray, "muscle local"], count: int) -> Int[np.ndarray, "layer variable"]:
    """Find where each variable stands: its first place, its second, ...; past its last, none."""
    order = np.argsort(index, axis=None, kind="stable")
    owner = index.ravel()[order]
    order, owner = order[owner < count], owner[owner < count]
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
    freed, paths, wraps = freedom.parameters, freedom.paths, freedom.wraps
    modes = 0 if paths is None else paths.free.shape[1]
    if wraps is not None:
        modes = wraps.places.size // len(muscles) * len(wraps.quantities)
    count = len(muscles)
    synergies = freedom.synergies
    weights = 0 if synergies is None else synergies.commands
    # Modes are parts of one change: it is the length of their vector that is expected to be short.
    mode_sd = np.inf if paths is None else paths.prior_sd * np.sqrt(count / paths.free.sum())

    def column(name: str, of_modes: float) -> Float[np.ndarray, "muscle local"]:
        single = [getattr(parameter, name) for parameter in freed]
        # Weights are no muscle's own: what is said here of them and of held modes is not asked for.
        return np.stack([*single, *[np.full(count, of_modes)] * (weights + modes)], axis=-1)

    scale = column("scale", 1.0)
    free = np.ones(scale.shape, dtype=bool)
    shared = len(freed) + weights
    free[:, len(freed) : shared] = False
    free[:, shared:] = False if paths is None else paths.free
    own = int(free.sum())
    index = np.full(free.shape, own)
    index[free] = np.arange(own)
    names = [parameter.name for parameter in freed] + [""] * weights
    names += [f"path_changes_{mode:03d}" for mode in range(modes)]
    labels = [f"{muscles[muscle]}.{names[place]}" for muscle, place in np.argwhere(free)]
    bounds = {
        name: (column(name, sign * np.inf) / scale)[free] for name, sign in (("lower", -1), ("upper", 1))
    }
    prior_mean = (column("prior_mean", 0.0) / scale)[free]
    prior_precision = (scale / column("prior_sd", mode_sd))[free]
    total = own + (0 if synergies is None else len(synergies.names) * weights)
    if wraps is not None:
        total += wraps.lower.size
    index[index == own] = total
    if synergies is not None:
        # After all muscles: muscles may have an excitation in common.
        number = own + synergies.places[:, None] * weights + np.arange(weights)
        index[:, len(freed) : shared] = np.where(synergies.places[:, None] < 0, total, number)
        labels += [f"{name}.{weight}" for name in synergies.names for weight in synergies.labels]
        size = len(synergies.names) * weights
        for name, sign in (("lower", -1.0), ("upper", 1.0)):
            bounds[name] = np.append(bounds[name], np.full(size, sign * synergies.bound))
        prior_mean = np.append(prior_mean, np.zeros(size))
        prior_precision = np.append(prior_precision, np.full(size, 1.0 / synergies.prior_sd))
        own += size
    if wraps is not None:
        # Last: a cylinder is nobody's own.
        held = wraps.places[:, :, None] < 0
        number = own + wraps.places[:, :, None] * len(wraps.quantities) + np.arange(len(wraps.quantities))
        index[:, shared:] = np.where(held, total, number).reshape(count, -1)
        scale[:, shared:] = np.where(held, 1.0, wraps.scale[wraps.places]).reshape(count, -1)
        labels += [f"{name}.{quantity}" for name in wraps.names for quantity in wraps.quantities]
        for name in bounds:
            bounds[name] = np.append(bounds[name], getattr(wraps, name) / wraps.scale)
        prior_mean = np.append(prior_mean, np.zeros(wraps.lower.size))
        prior_precision = np.append(prior_precision, wraps.scale / wraps.prior_sd)
    return Variables(
        base=base,
        names=tuple(parameter.name for parameter in freed),
        weights=weights,
        modes=modes,
        scale=scale,
        index=index,
        places=_places(index, len(labels)),
        lower=bounds["lower"],
        upper=bounds["upper"],
        prior_mean=prior_mean,
        prior_precision=prior_precision,
        labels=tuple(labels),
    )
