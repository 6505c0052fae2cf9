"""Alterations of EMG and muscle paths that several effects share."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
from jaxtyping import Array, Float

from wrapjax.geometry.paths import PathState
from wrapjax.muscle.excitation import EmgSpline


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
