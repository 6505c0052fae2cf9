"""Where a model may be altered: what a plain one leaves out, off at zero amount.

A muscle's own part sees that muscle alone, so derivatives stay one small block a muscle. What mixes
muscles acts before them, on the EMG, or on their paths, whose moment arms say where forces go.

Tendons, by name: what puts fibers in series with another than a rigid one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry.paths import PathState
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.activation import DEACTIVATION_RATIO
from wrapjax.muscle.compliant_tendon import compliant_tendon_fiber
from wrapjax.muscle.curves import AbstractCurves
from wrapjax.muscle.excitation import EmgSpline
from wrapjax.muscle.hill import FiberState


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


def muscle_alterations(alterations: tuple[Alteration, ...]) -> tuple[MuscleAlteration, ...]:
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


#: Strain at maximum isometric force of each kind of tendon: none, as the NMSM Pipeline has it, or what
#: most tendons have (Zajac 1989, Crit Rev Biomed Eng 17:359; PMC3656509, with 0.10 of the Achilles tendon).
TENDONS = {"rigid": 0.0, "compliant": 0.04}


class CompliantTendon(MuscleAlteration):
    """Put fibers in series with a tendon that stretches."""

    strain_at_max_force: Float[Array, "*muscle"]

    def tendon(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """See `MuscleAlteration`."""
        return compliant_tendon_fiber(
            inputs.curves,
            activation,
            inputs.path.length,
            inputs.path.velocity,
            inputs.emg.step,
            self.strain_at_max_force,
            **inputs.law,
        )


def tendon_alterations(tendon: str, muscles: int) -> tuple[Alteration, ...]:
    """Alter so many muscles to this kind of tendon; rigid ones need nothing.

    Parameters
    ----------
    tendon
        One of `TENDONS`.
    muscles
        How many.

    Raises
    ------
    ValueError
        If there is no such kind.
    """
    if tendon not in TENDONS:
        raise ValueError(f"unknown tendon '{tendon}': expected one of {', '.join(TENDONS)}")
    strain = TENDONS[tendon]
    return () if strain == 0.0 else (Alteration(muscle=CompliantTendon(jnp.full(muscles, strain))),)
