"""Tendons, by name: what puts fibers in series with another than a rigid one."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs
from wrapjax.muscle import FiberState, compliant_tendon_fiber

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
