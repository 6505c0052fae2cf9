"""Alterations of the forward model: changes at its stages, from EMG to joint moments.

A compliant tendon is one alteration; the effects of a diagnosis are others. Alterations of a single muscle
depend on that muscle alone, so that derivatives remain one small block per muscle. Alterations that couple
muscles act before the muscles, on the EMG or on the paths, or add to the joint moments after them.
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
    """Select the arguments of `rigid_tendon_fiber` from the parameter tree, by name."""
    return {
        "max_isometric_force": parameters.max_isometric_force,
        "optimal_fiber_length": parameters.optimal_fiber_length,
        "tendon_slack_length": parameters.tendon_slack_length,
        "pennation_angle": parameters.pennation_angle,
        "max_fiber_velocity": parameters.max_fiber_velocity,
    }


class MuscleInputs(eqx.Module):
    """Inputs of the model of one muscle."""

    curves: AbstractCurves
    parameters: ModelParameters
    path: PathState
    emg: EmgSpline
    #: Frames of EMG before and after each cycle.
    padding: int = eqx.field(static=True)
    #: Ratio of the deactivation to the activation time constant, see `neural_activation`.
    deactivation_ratio: Float[Array, ""] | float = DEACTIVATION_RATIO
    #: Factor on the optimal fiber length in each frame; None for 1.
    length_factor: Float[Array, "trial frame"] | None = None

    @property
    def law(self) -> dict[str, Any]:
        """Keyword arguments of `rigid_tendon_fiber` and `compliant_tendon_fiber`."""
        return {**fiber_parameters(self.parameters), "length_factor": self.length_factor}


class MuscleAlteration(eqx.Module):
    """Changes of the model of one muscle, one method per stage; by default every stage is unchanged.

    Leaves have no axis ``muscle`` in these methods; in an `Alteration` it is their leading axis.
    """

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """Return the altered inputs of the muscle; here unchanged."""
        return inputs

    def excitation(
        self, excitation: Float[Array, "trial padded_frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial padded_frame"]:
        """Return the altered excitation; here unchanged."""
        return excitation

    def activation(
        self, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial frame"]:
        """Return the altered activation; here unchanged."""
        return activation

    def fibers(self, inputs: MuscleInputs, activation: Float[Array, "trial frame"]) -> MuscleInputs:
        """Return the altered inputs of fibers and tendon, given the activation; here unchanged."""
        return inputs

    def tendon(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """Replace the fiber state of a rigid tendon by that of another tendon."""
        return fiber

    def force(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """Return the altered fiber state and force; here unchanged."""
        return fiber


class Alteration(eqx.Module):
    """Changes of the forward model of a leg; parts that are None change nothing.

    Functions are `jax.tree_util.Partial` objects, so that their arrays are leaves.
    """

    #: Change of the EMG of all muscles.
    emg: Callable[[EmgSpline], EmgSpline] | None = None
    #: Change of the paths of all muscles; it must not depend on muscle parameters.
    paths: Callable[[PathState], PathState] | None = None
    #: Changes of single muscles; the leading axis of the leaves is ``muscle``.
    muscle: MuscleAlteration | None = None
    #: Joint moments added to those of the muscles, N m; they must not depend on muscle parameters.
    moment: Float[Array, "trial coordinate frame"] | None = None


def altered_emg(emg: EmgSpline, alterations: tuple[Alteration, ...]) -> EmgSpline:
    """Apply the changes of the EMG of all muscles."""
    for alteration in alterations:
        if alteration.emg is not None:
            emg = alteration.emg(emg)
    return emg


def altered_paths(paths: PathState, alterations: tuple[Alteration, ...]) -> PathState:
    """Apply the changes of the paths of all muscles."""
    for alteration in alterations:
        if alteration.paths is not None:
            paths = alteration.paths(paths)
    return paths


def muscle_alterations(alterations: tuple[Alteration, ...]) -> tuple[MuscleAlteration, ...]:
    """Select the changes of single muscles; the leading axis of their leaves is ``muscle``."""
    return tuple(alteration.muscle for alteration in alterations if alteration.muscle is not None)


def altered_moments(
    moments: Float[Array, "trial coordinate frame"], alterations: tuple[Alteration, ...]
) -> Float[Array, "trial coordinate frame"]:
    """Add the joint moments of the alterations to those of the muscles, N m."""
    for alteration in alterations:
        if alteration.moment is not None:
            moments = moments + alteration.moment
    return moments


#: Strain at maximum isometric force of each kind of tendon: zero as in the NMSM Pipeline, or the value of
#: most tendons (Zajac 1989, Crit Rev Biomed Eng 17:359; PMC3656509, which has 0.10 for the Achilles tendon).
TENDONS = {"rigid": 0.0, "compliant": 0.04}


class CompliantTendon(MuscleAlteration):
    """Compliant tendon in series with the fibers."""

    strain_at_max_force: Float[Array, "*muscle"]

    def tendon(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """Compute the fiber state with the compliant tendon; see `MuscleAlteration`."""
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
    """Build the alterations that give muscles a kind of tendon; none for a rigid one.

    Parameters
    ----------
    tendon
        Kind of tendon, one of `TENDONS`.
    muscles
        Number of muscles.

    Raises
    ------
    ValueError
        If the kind of tendon is unknown.
    """
    if tendon not in TENDONS:
        raise ValueError(f"unknown tendon '{tendon}': expected one of {', '.join(TENDONS)}")
    strain = TENDONS[tendon]
    return () if strain == 0.0 else (Alteration(muscle=CompliantTendon(jnp.full(muscles, strain))),)
