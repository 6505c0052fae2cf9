"""Mapping between the parameter tree and the vector of variables of a solver."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, Shaped

from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import ModelParameters, with_path_modes

#: Owner of the parameters of the muscle law in labels of variables.
LAW_OWNER = "muscle_law"
#: Largest number of batches of muscles; programs are compiled for each.
MAX_BATCHES = 5


class Batch(NamedTuple):
    """Muscles with similar numbers of free local entries.

    The muscles of a leg have 5 to 91 path modes where coefficients are free (SGA). Padded to the same number
    for all muscles, two thirds of all derivatives by local entries would be zeros.
    """

    muscles: tuple[int, ...]
    #: Number of local entries, of which the last ones of some muscles may be held.
    entries: int


class LocalBlocks(eqx.Module):
    """Derivatives by the local entries of all muscles, batch by batch."""

    batches: tuple[Batch, ...] = eqx.field(static=True)
    #: The axes of each part are ``muscle local``, followed by others.
    parts: tuple[Float[Array, "_ _ ..."], ...]

    def map(self, function: Callable[..., Array], *by_muscle: Shaped[Array, "_ ..."]) -> LocalBlocks:
        """Apply a function to the part of each batch, and to the rows of its muscles in other arrays."""
        parts = [
            function(part, *(of_batch(batch, array) for array in by_muscle))
            for batch, part in zip(self.batches, self.parts, strict=True)
        ]
        return LocalBlocks(self.batches, tuple(parts))

    def of_muscle(self, muscle: int) -> Float[Array, "local ..."]:
        """Select the derivatives by the local entries of one muscle."""
        for batch, part in zip(self.batches, self.parts, strict=True):
            if muscle in batch.muscles:
                return part[batch.muscles.index(muscle)]
        raise IndexError(f"there is no muscle {muscle}")

    def __add__(self, other: LocalBlocks) -> LocalBlocks:
        """Add the parts of the same batches."""
        pairs = zip(self.parts, other.parts, strict=True)
        return LocalBlocks(self.batches, tuple(one + another for one, another in pairs))


def of_batch(batch: Batch, tree: PyTree) -> PyTree:
    """Select the rows of the muscles of a batch from all arrays, whose first axis is ``muscle``."""
    if batch.muscles == tuple(range(len(batch.muscles))):
        return jax.tree.map(lambda leaf: leaf[: len(batch.muscles)], tree)
    return jax.tree.map(lambda leaf: leaf[np.array(batch.muscles)], tree)


class Variables(eqx.Module):
    """Free entries of a parameter tree as a vector of variables of order one.

    A muscle's force depends on that muscle's parameters alone. Each muscle therefore has a short vector of
    local entries (scalar parameters, synergy weights, muscle law, path modes), and ``index`` maps local
    entries to variables. Local entries of several muscles may refer to one variable: such parameters are
    shared.
    """

    #: Parameter tree with the values of entries that are held, and the initial values of free ones.
    base: ModelParameters
    #: Free scalar parameters: the first local entries.
    names: tuple[str, ...] = eqx.field(static=True)
    #: Number of synergy weights, the next local entries; 0 where every muscle has a channel.
    weights: int = eqx.field(static=True)
    #: Number of parameters of the muscle law, the next local entries; 0 where the law is held.
    laws: int = eqx.field(static=True)
    #: Number of path modes, the last local entries; 0 where paths are held.
    modes: int = eqx.field(static=True)
    #: Size of one solver unit, in the unit of the entry.
    scale: Float[np.ndarray, "muscle local"]
    #: Variable of each local entry; the number of variables for an entry that is held.
    index: Int[np.ndarray, "muscle local"]
    #: Muscles with similar numbers of free local entries; their derivatives are computed together.
    batches: tuple[Batch, ...] = eqx.field(static=True)
    #: Flat positions of each variable in `LocalBlocks` of these batches, one row for each muscle that may
    #: share it.
    places: Int[np.ndarray, "layer variable"]
    lower: Float[np.ndarray, " variable"]
    upper: Float[np.ndarray, " variable"]
    prior_mean: Float[np.ndarray, " variable"]
    #: One over the prior standard deviation; 0 without a prior.
    prior_precision: Float[np.ndarray, " variable"]
    #: Name of each variable, as ``soleus_l.emg_scale``.
    labels: tuple[str, ...] = eqx.field(static=True)

    @property
    def count(self) -> int:
        """Number of variables."""
        return len(self.labels)

    @property
    def nonpath_count(self) -> int:
        """Number of local entries of a muscle that are not path modes."""
        return len(self.names) + self.weights + self.laws

    @property
    def all_muscles(self) -> Batch:
        """All muscles, padded to the same number of local entries."""
        return Batch(tuple(range(self.index.shape[0])), self.index.shape[1])

    def start(self) -> Float[Array, " variable"]:
        """Compute the variables of the base parameters, clipped to the bounds."""
        return jnp.clip(self.pack(self.base), self.lower, self.upper)

    @eqx.filter_jit
    def pack(self, parameters: ModelParameters) -> Float[Array, " variable"]:
        """Extract the variables from a parameter tree; the last muscle's value where a variable is shared.

        The tree may have no path modes, as trees of held paths do.
        """
        padded = with_path_modes(parameters, self.modes)
        return jnp.zeros(self.count + 1).at[self.index].set(self._local(padded))[:-1]

    @eqx.filter_jit
    def unpack(self, variables: Float[Array, " variable"]) -> ModelParameters:
        """Insert variables into the base parameter tree."""
        values = self.localize(variables) * self.scale
        tree = self.insert(self.base, values[:, : self.nonpath_count])
        if not self.modes:
            return tree
        return eqx.tree_at(lambda tree: tree.path_changes, tree, values[:, self.nonpath_count :])

    def localize(self, variables: Float[Array, " variable"]) -> Float[Array, "muscle local"]:
        """Compute the local entries of every muscle, in solver units; held entries have their base values."""
        held = self.index == self.count
        return jnp.where(held, self._local(self.base), jnp.append(variables, 0.0)[self.index])

    def scatter(self, move: Float[Array, " variable"]) -> LocalBlocks:
        """Distribute a change of the variables to the local entries of every muscle."""
        local = jnp.append(move, 0.0)[self.index]
        parts = [of_batch(batch, local)[:, : batch.entries] for batch in self.batches]
        return LocalBlocks(self.batches, tuple(parts))

    def _local(self, parameters: ModelParameters) -> Float[Array, "muscle local"]:
        single = jnp.stack([getattr(parameters, name) for name in self.names], axis=-1)
        parts = [single]
        if parameters.synergy_weights is not None:
            parts.append(parameters.synergy_weights[:, : self.weights])
        if self.laws:
            assert parameters.law is not None
            parts.append(parameters.law)
        parts.append(parameters.path_changes[:, : self.modes])
        return jnp.concatenate(parts, axis=-1) / self.scale

    def insert(self, parameters: ModelParameters, values: Float[Array, "*muscle single"]) -> ModelParameters:
        """Insert all entries but path modes, in their units, into a tree of one or all muscles."""
        leaves = [values[..., place] for place in range(len(self.names))]
        names = list(self.names)
        first_law = len(names) + self.weights
        if self.weights:
            leaves.append(values[..., len(self.names) : first_law])
            names.append("synergy_weights")
        if self.laws:
            leaves.append(values[..., first_law : first_law + self.laws])
            names.append("law")
        return eqx.tree_at(lambda tree: [getattr(tree, name) for name in names], parameters, replace=leaves)

    def gather(self, blocks: LocalBlocks) -> Float[Array, "variable row"]:
        """Sum derivatives by local entries into derivatives by variables (chain rule)."""
        flat = jnp.concatenate([part.reshape(-1, part.shape[-1]) for part in blocks.parts])
        if len(self.places) == 1:
            return flat[self.places[0]]
        flat = jnp.concatenate([flat, jnp.zeros_like(flat[:1])])
        return sum((flat[layer] for layer in self.places[1:]), start=flat[self.places[0]])

    def assemble(
        self,
        own: LocalBlocks,
        groups: Mapping[tuple[int, ...], Float[Array, "_ _"]] = MappingProxyType({}),
    ) -> Float[Array, "variable variable"]:
        """Assemble second derivatives by local entries into those by variables.

        Parameters
        ----------
        own
            Second derivatives of every muscle by its own entries.
        groups
            Second derivatives by the entries of several muscles, by the indices of these muscles.
        """
        rows, columns = [], []
        for batch in self.batches:
            index = of_batch(batch, self.index)[:, : batch.entries]
            rows.append(jnp.repeat(index, batch.entries, axis=1).ravel())
            columns.append(jnp.tile(index, (1, batch.entries)).ravel())
        entries = {muscle: batch.entries for batch in self.batches for muscle in batch.muscles}
        for members in groups:
            index = jnp.concatenate([self.index[muscle, : entries[muscle]] for muscle in members])
            rows.append(jnp.repeat(index, len(index)))
            columns.append(jnp.tile(index, len(index)))
        values = jnp.concatenate([block.ravel() for block in (*own.parts, *groups.values())])
        # One scatter for all blocks: each scatter would allocate a matrix of its own.
        total = jnp.zeros((self.count + 1, self.count + 1))
        return total.at[jnp.concatenate(rows), jnp.concatenate(columns)].add(values)[:-1, :-1]


def divide_muscles(free: Bool[np.ndarray, "muscle local"]) -> tuple[Batch, ...]:
    """Divide the muscles into the batches that need the least padding, in the order of their entries."""
    needed = free.shape[1] - np.argmax(free[:, ::-1], axis=1)
    order = np.argsort(needed, kind="stable")
    sizes = needed[order].tolist()
    ends = np.flatnonzero(np.diff(sizes)) + 1

    def divided(cuts: tuple[int, ...]) -> list[tuple[int, int]]:
        return list(itertools.pairwise((0, *cuts, len(sizes))))

    def padded(cuts: tuple[int, ...]) -> int:
        return sum((last - first) * sizes[last - 1] for first, last in divided(cuts))

    choices = itertools.combinations(ends.tolist(), min(MAX_BATCHES - 1, len(ends)))
    return tuple(
        Batch(tuple(sorted(order[first:last].tolist())), sizes[last - 1])
        for first, last in divided(min(choices, key=padded))
    )


def _places(
    index: Int[np.ndarray, "muscle local"], batches: Sequence[Batch], count: int
) -> Int[np.ndarray, "layer variable"]:
    """Find the first, second, ... position of each variable in local blocks; their size past the last one."""
    flat = np.concatenate([index[list(one.muscles), : one.entries].ravel() for one in batches])
    order = np.argsort(flat, kind="stable")
    variable_of = flat[order]
    order, variable_of = order[variable_of < count], variable_of[variable_of < count]
    occurrence = np.arange(len(variable_of)) - np.searchsorted(variable_of, variable_of)
    places = np.full((int(occurrence.max()) + 1, count), flat.size)
    places[occurrence, variable_of] = order
    return places


def free_variables(base: ModelParameters, freedom: Freedom, muscles: Sequence[str]) -> Variables:
    """Build the variables of a freedom.

    Their order is: scalar parameters and path modes muscle by muscle, then synergy weights, then the muscle
    law, then wrap parameters.

    Parameters
    ----------
    base
        Values of entries that are held, and initial values of free ones.
    freedom
        Selection of the parameters that may change.
    muscles
        Names of the muscles, in the order of the tree's leading axis.
    """
    freed, paths, wraps = freedom.parameters, freedom.paths, freedom.wraps
    modes = 0 if paths is None else paths.free.shape[1]
    if wraps is not None:
        modes = wraps.places.size // len(muscles) * len(wraps.quantities)
    count = len(muscles)
    synergies = freedom.synergies
    weights = 0 if synergies is None else synergies.commands
    laws = 0 if freedom.law is None else len(freedom.law.names)
    # The prior is on the norm of the vector of mode coefficients, not on each of them.
    mode_sd = np.inf if paths is None else paths.prior_sd * np.sqrt(count / paths.free.sum())

    def per_muscle_values(name: str, mode_value: float) -> Float[np.ndarray, "muscle local"]:
        single = [getattr(parameter, name) for parameter in freed]
        # Values of synergy weights and of the law, set below, and of held modes are placeholders.
        return np.stack([*single, *[np.full(count, mode_value)] * (weights + laws + modes)], axis=-1)

    scale = per_muscle_values("scale", 1.0)
    free = np.ones(scale.shape, dtype=bool)
    first_law = len(freed) + weights
    first_mode = first_law + laws
    free[:, len(freed) : first_mode] = False
    free[:, first_mode:] = False if paths is None else paths.free
    offset = int(free.sum())
    index = np.full(free.shape, offset)
    index[free] = np.arange(offset)
    names = [parameter.name for parameter in freed] + [""] * (weights + laws)
    names += [f"path_changes_{mode:03d}" for mode in range(modes)]
    labels = [f"{muscles[muscle]}.{names[place]}" for muscle, place in np.argwhere(free)]
    bounds = {
        name: (per_muscle_values(name, sign * np.inf) / scale)[free]
        for name, sign in (("lower", -1), ("upper", 1))
    }
    prior_mean = (per_muscle_values("prior_mean", 0.0) / scale)[free]
    prior_precision = (scale / per_muscle_values("prior_sd", mode_sd))[free]
    total = offset + laws + (0 if synergies is None else len(synergies.names) * weights)
    if wraps is not None:
        total += int(wraps.free.sum())
    index[index == offset] = total
    if synergies is not None:
        # After the variables of single muscles: several muscles may share an excitation.
        number = offset + synergies.places[:, None] * weights + np.arange(weights)
        index[:, len(freed) : first_law] = np.where(synergies.places[:, None] < 0, total, number)
        labels += [f"{name}.{weight}" for name in synergies.names for weight in synergies.labels]
        size = len(synergies.names) * weights
        for name, sign in (("lower", -1.0), ("upper", 1.0)):
            bounds[name] = np.append(bounds[name], np.full(size, sign * synergies.bound))
        prior_mean = np.append(prior_mean, np.zeros(size))
        prior_precision = np.append(prior_precision, np.full(size, 1.0 / synergies.prior_sd))
        offset += size
    if freedom.law is not None:
        index[:, first_law:first_mode] = offset + np.arange(laws)
        scale[:, first_law:first_mode] = freedom.law.prior_sd
        labels += [f"{LAW_OWNER}.{name}" for name in freedom.law.names]
        for name in bounds:
            bounds[name] = np.append(bounds[name], getattr(freedom.law, name) / freedom.law.prior_sd)
        prior_mean = np.append(prior_mean, np.zeros(laws))
        # Priors of muscles are means over muscles; that of the law counts as much as one muscle's.
        prior_precision = np.append(prior_precision, np.full(laws, 1.0 / np.sqrt(count)))
        offset += laws
    if wraps is not None:
        # Last: several muscles may share a wrap.
        freed_entries = wraps.free
        held = (wraps.places[:, :, None] < 0) | ~freed_entries[wraps.places]
        number = offset + np.cumsum(freed_entries.ravel()).reshape(freed_entries.shape) - 1
        index[:, first_mode:] = np.where(held, total, number[wraps.places]).reshape(count, -1)
        scale[:, first_mode:] = np.where(held, 1.0, wraps.scale[wraps.places]).reshape(count, -1)
        labels += [
            f"{wraps.names[wrap]}.{wraps.quantities[quantity]}"
            for wrap, quantity in np.argwhere(freed_entries)
        ]
        for name in bounds:
            bounds[name] = np.append(bounds[name], (getattr(wraps, name) / wraps.scale)[freed_entries])
        prior_mean = np.append(prior_mean, np.zeros(freed_entries.sum()))
        prior_precision = np.append(prior_precision, (wraps.scale / wraps.prior_sd)[freed_entries])
    # The derivatives of paths by wrap parameters are computed for all muscles at once.
    everything = Batch(tuple(range(count)), scale.shape[-1])
    batches = (everything,) if paths is None else divide_muscles(index < total)
    return Variables(
        base=base,
        names=tuple(parameter.name for parameter in freed),
        weights=weights,
        laws=laws,
        modes=modes,
        scale=scale,
        index=index,
        batches=batches,
        places=_places(index, batches, len(labels)),
        lower=bounds["lower"],
        upper=bounds["upper"],
        prior_mean=prior_mean,
        prior_precision=prior_precision,
        labels=tuple(labels),
    )
