"""Changes of a subject's measured moments and recorded paths by errors in the inputs of inverse dynamics."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import MeasuredChange
from wrapjax.diagnosis.effects.catalogue import DEFINITIONS
from wrapjax.diagnosis.effects.effect import EffectSizes
from wrapjax.diagnosis.recorded_inputs.recorded_gait import RecordedGait
from wrapjax.diagnosis.recorded_inputs.recorded_paths import RecordedPaths
from wrapjax.geometry.paths import PathState


def compute_measured_changes(gait: RecordedGait) -> dict[str, dict[str, MeasuredChange]]:
    """Compute what each effect adds to the measured moments.

    An effect size is an error in the laboratory's inputs of inverse dynamics, and the change is what this
    error added to the moments. It is linear in the effect sizes.

    Parameters
    ----------
    gait
        Recorded gait.

    Returns
    -------
    changes
        By identifier of the effect and label of the variant: functions from effect sizes to N m (trial x
        coordinate x frame). Effects and variants that change nothing are left out.
    """
    return {
        definition.id: changes
        for definition in DEFINITIONS
        if definition.moment_derivatives is not None
        and (
            changes := {
                label: _linear_change(gait, derivatives)
                for label, derivatives in definition.moment_derivatives(gait).items()
                if derivatives.any()
            }
        )
    }


def compute_path_changes(
    recorded: RecordedPaths, measured: Collection[str]
) -> dict[str, Mapping[str, PathState]]:
    """Compute what a unit of each effect size adds to the recorded paths (`Context.path_changes`).

    Parameters
    ----------
    recorded
        Recorded paths.
    measured
        Identifiers of the effects that change the measured moments; paths of other effects are not needed.
    """
    return {
        definition.id: changes
        for definition in DEFINITIONS
        if definition.id in measured
        and definition.path_derivatives is not None
        and (changes := definition.path_derivatives(recorded))
    }


def _linear_change(
    gait: RecordedGait, derivatives: Float[np.ndarray, "parameter coordinate pose"]
) -> MeasuredChange:
    by_trial = derivatives.reshape(*derivatives.shape[:2], *gait.time.shape)
    return Partial(_sum_changes, jnp.asarray(np.moveaxis(by_trial, 1, 2)))


def _sum_changes(
    derivatives: Float[Array, "parameter trial coordinate frame"], effect_sizes: EffectSizes
) -> Float[Array, "trial coordinate frame"]:
    return jnp.tensordot(effect_sizes, derivatives, axes=1)
