"""Where a model may be altered: what a plain one leaves out, off at zero amount.

A muscle's own part sees that muscle alone, so derivatives stay one small block a muscle. What mixes
muscles acts before them, on the EMG, or on their paths, whose moment arms say where forces go.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from wrapjax.geometry import PathState
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle import DEACTIVATION_RATIO, AbstractCurves, EmgSpline, FiberState


def fiber_parameters(parameters: ModelParameters) -> dict[str, Any]:
    """Pick what the law of fibers takes by name."""
    return {
        "max_isometric_force": parameters.max_isometric_force,
        "optimal_fiber_length": parameters.optimal_fiber_length,
        "tendon_slack_length": parameters.tendon_slack_length,
        "pennation_angle": parameters.pennation_angle,
        "max_fiber_velocity": parameters.max_fiber_velocity,
    }


class MuscleInputs(eqx.Module):
    """All that decides what one muscle does."""

    curves: AbstractCurves
    parameters: ModelParameters
    path: PathState
    emg: EmgSpline
    #: Frames of EMG before and after each cycle.
    padding: int = eqx.field(static=True)
    #: See `neural_activation`.
    deactivation_ratio: Float[Array, ""] | float = DEACTIVATION_RATIO
    #: What multiplies the optimal fiber length, frame by frame; None for nothing.
    length_factor: Float[Array, "trial frame"] | None = None

    @property
    def law(self) -> dict[str, Any]:
        """What the laws of fibers and tendon take by name."""
        return {**fiber_parameters(self.parameters), "length_factor": self.length_factor}


class MuscleAlteration(eqx.Module):
    """What is different in one muscle, stage by stage; every stage hands on what it is given.

    Leaves have no axis ``muscle`` here; in an `Alteration` they lead with it.
    """

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """Alter what the muscle starts from."""
        return inputs

    def excitation(
        self, excitation: Float[Array, "trial padded_frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial padded_frame"]:
        """Alter its excitation."""
        return excitation

    def activation(
        self, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial frame"]:
        """Alter its activation."""
        return activation

    def fibers(self, inputs: MuscleInputs, activation: Float[Array, "trial frame"]) -> MuscleInputs:
        """Alter what fibers and tendon are, now that activation is known."""
        return inputs

    def tendon(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """Put fibers in series with another tendon than a rigid one."""
        return fiber

    def force(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """Alter the force that fibers give in the end."""
        return fiber


class Alteration(eqx.Module):
    """What is different in a leg; parts that are None leave everything as it is.

    Functions are `jax.tree_util.Partial` ones, so that their arrays are leaves.
    """

    #: Of all muscles, before any of them.
    emg: Callable[[EmgSpline], EmgSpline] | None = None
    #: Of all muscles, before any of them. What it makes of a path must not depend on other muscles'
    #: parameters.
    paths: Callable[[PathState], PathState] | None = None
    #: Leaves lead with ``muscle``.
    muscle: MuscleAlteration | None = None
    #: Added to what muscles do, N m: a function of what was recorded, not of any muscle's parameter.
    moment: Float[Array, "trial coordinate frame"] | None = None


def altered_emg(emg: EmgSpline, alterations: tuple[Alteration, ...]) -> EmgSpline:
    """Alter the EMG of all muscles."""
    for alteration in alterations:
        if alteration.emg is not None:
            emg = alteration.emg(emg)
    return emg


def altered_paths(paths: PathState, alterations: tuple[Alteration, ...]) -> PathState:
    """Alter the paths of all muscles."""
    for alteration in alterations:
        if alteration.paths is not None:
            paths = alteration.paths(paths)
    return paths


def muscle_parts(alterations: tuple[Alteration, ...]) -> tuple[MuscleAlteration, ...]:
    """Take what alters single muscles; leaves lead with ``muscle``."""
    return tuple(alteration.muscle for alteration in alterations if alteration.muscle is not None)


def altered_moments(
    moments: Float[Array, "trial coordinate frame"], alterations: tuple[Alteration, ...]
) -> Float[Array, "trial coordinate frame"]:
    """Add what is not muscles'."""
    for alteration in alterations:
        if alteration.moment is not None:
            moments = moments + alteration.moment
    return moments
