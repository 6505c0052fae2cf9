"""Share of each joint's moment capacity that muscles without EMG have, and their moments in null hypotheses.

Where most of the muscles that flex a joint have no electrode, the moment error at that joint says little
about any other cause. The excitation of such muscles is therefore uncertain in every null hypothesis. Where
most of all muscles of a coordinate have none, its whole moment is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.diagnosis.effects.periodic import periodic_splines
from wrapjax.diagnosis.effects.unrecorded_excitation import SPLINES, active_moments
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.diagnosis.null_hypotheses.error_sources import periodic_kernel
from wrapjax.subject.trials import GAIT, PASSIVE

#: Standard deviation of an unrecorded activation where most muscles of a direction have no EMG: peaks in
#: walking are 0.1 to 0.6 of a maximum contraction (Perry 2010; Ao et al. 2022,
#: doi:10.3389/fbioe.2022.962959).
ACTIVATION_SD = 0.2
#: Share of the capacity without EMG up to which a direction, or a coordinate, is taken as recorded.
RECORDED_SHARE = 0.5
#: Share of a direction's capacity without EMG from which the activation is uncertain in full.
UNRECORDED_SHARE = 0.6
#: Correlation width of the moment of an unrecorded coordinate, in gait cycles.
MOMENT_WIDTH = 0.05


@dataclass(frozen=True)
class CapacityShare:
    """Share of the moment capacity of muscles without EMG, 0 to 1.

    Parameters
    ----------
    positive, negative
        Share in either direction of a coordinate.
    both
        Share of the sum of both directions.
    """

    positive: float
    negative: float
    both: float

    @property
    def has_emg_for_most(self) -> bool:
        """Whether muscles with EMG have most of the capacity."""
        return self.both <= RECORDED_SHARE


def undriven_capacity(context: Context) -> Mapping[str, CapacityShare]:
    """Compute the share of each coordinate's moment capacity without EMG.

    The capacity of a muscle is its maximum isometric force times the mean of its moment arm over all frames
    in which the arm has the direction.

    Parameters
    ----------
    context
        Context of the cycles.
    """
    driven = _capacity(context.paths.moment_arm, context.parameters.max_isometric_force)
    others = context.undriven_muscles
    if others is None:
        return {name: CapacityShare(0.0, 0.0, 0.0) for name in context.coordinates}
    undriven = _capacity(others.path.moment_arm, others.parameters.max_isometric_force)
    of_undriven = undriven.sum(axis=0)
    total = np.maximum(driven.sum(axis=0) + of_undriven, 1e-12)
    share, share_of_both = of_undriven / total, of_undriven.sum(axis=0) / total.sum(axis=0)
    return {
        name: CapacityShare(float(share[0, place]), float(share[1, place]), float(share_of_both[place]))
        for place, name in enumerate(context.coordinates)
    }


def _capacity(
    arms: Float[Array | np.ndarray, "muscle trial coordinate frame"],
    force: Float[Array | np.ndarray, " muscle"],
) -> Float[np.ndarray, "muscle direction coordinate"]:
    """Compute the moment capacity of each muscle in the positive and the negative direction, N m."""
    arms = np.asarray(arms)
    mean_arms = np.stack([np.maximum(arms, 0.0), np.maximum(-arms, 0.0)], axis=1).mean(axis=(2, 4))
    return mean_arms * np.asarray(force)[:, None, None]


def undriven_signatures(
    context: Context, frames: Int[np.ndarray, " phase"]
) -> Float[np.ndarray, "parameter cycle coordinate phase"]:
    """Compute the moments by unrecorded activations of one standard deviation, N m.

    Each group of muscles with a common excitation has one parameter for each spline of the cycle. Groups that
    act in recorded directions alone have none.

    Parameters
    ----------
    context
        Context of the cycles.
    frames
        Frames at which moments are compared.
    """
    empty = np.zeros((0, len(context.trials), len(context.coordinates), len(frames)))
    others = context.undriven_muscles
    if others is None:
        return empty
    shares = undriven_capacity(context)
    by_direction = np.array(
        [[shares[name].positive, shares[name].negative] for name in context.coordinates]
    ).T
    unrecorded = np.clip((by_direction - RECORDED_SHARE) / (UNRECORDED_SHARE - RECORDED_SHARE), 0.0, 1.0)
    acts = _capacity(others.path.moment_arm, others.parameters.max_isometric_force)
    # A muscle counts for a direction where it has at least a tenth of the largest capacity without EMG.
    counts = acts > 0.1 * acts.max(axis=0, keepdims=True)
    weight = np.max(counts * unrecorded[None], axis=(1, 2))
    groups = [np.array([others.names.index(name) for name in members]) for _, members in others.groups]
    full = active_moments(others, jnp.ones(others.path.length.shape))
    per_unit = np.asarray(full)[..., frames]
    splines = periodic_splines(context.phase[frames], SPLINES)
    signatures = [
        ACTIVATION_SD
        * weight[rows].max()
        * splines.T[:, None, None]
        * (per_unit[rows].sum(axis=0) * same[:, None, None])[None]
        for rows in groups
        if weight[rows].max() > 0.0
        for same in _alike(context)
    ]
    return np.concatenate([empty, *signatures])


def _alike(context: Context) -> list[Bool[np.ndarray, " cycle"]]:
    """Mark the cycles whose unrecorded activation is the same: gait, and each trial of another active task.

    In a passive trial all muscles are at rest.
    """
    gait, names = context.is_gait, np.array(context.trials)
    others = [
        name for name, task in zip(context.trials, context.tasks, strict=False) if task not in (GAIT, PASSIVE)
    ]
    return [mask for mask in (gait, *(names == name for name in others)) if mask.any()]


def unrecorded_moment_signatures(
    context: Context,
    measured: Float[np.ndarray, "cycle coordinate phase"],
    speeds: Int[np.ndarray, " cycle"],
) -> Float[np.ndarray, "parameter cycle coordinate phase"]:
    """Compute smooth moments of one standard deviation at coordinates whose muscles mostly have no EMG, N m.

    The moment at such a coordinate cannot be predicted, whatever the cause. It is as uncertain as it is
    large, independently at each speed, so that its error is hardly evidence for any effect.

    Parameters
    ----------
    context
        Context of the cycles.
    measured
        Measured moments, N m.
    speeds
        Speed number of each cycle, counted from 0.
    """
    phases = measured.shape[-1]
    kernel = periodic_kernel(phases, MOMENT_WIDTH)
    values, vectors = np.linalg.eigh(kernel)
    kept = values > 1e-3 * values[-1]
    shapes = np.sqrt(values[kept])[:, None] * vectors.T[kept]
    signatures = [np.zeros((0, *measured.shape))]
    for place, share in enumerate(undriven_capacity(context).values()):
        if share.has_emg_for_most:
            continue
        size = np.sqrt(np.mean(measured[:, place] ** 2))
        for speed in np.unique(speeds):
            own = np.zeros((len(shapes), *measured.shape))
            own[:, speeds == speed, place] = size * shapes[:, None]
            signatures.append(own)
    return np.concatenate(signatures)
