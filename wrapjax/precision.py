"""Refusing to calculate in single precision."""

from __future__ import annotations

import jax


def require_float64() -> None:
    """Raise unless JAX calculates in 64 bits.

    In 32 bits a fifth-degree polynomial loses a millimeter and a solver stops far from its optimum.
    The switch is the caller's: flipping it here would change the caller's other programs.
    """
    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError(
            "wrapjax calculates in 64 bits, and JAX is set to 32: "
            'call jax.config.update("jax_enable_x64", True) before the first JAX operation'
        )
