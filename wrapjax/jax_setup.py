"""How JAX is set up for long work. JAX is imported only when it is done: threads must be set before.

Refusing to calculate in single precision.
"""

from __future__ import annotations

import os
from importlib.metadata import version
from pathlib import Path

#: What decides the thread counts of XLA and of the numerical libraries.
THREAD_VARIABLES = ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")

#: Options of XLA by the series of jaxlib they were tried with: one that it does not know ends the process.
_COMPILER_OPTIONS = {"0.10": ("--xla_cpu_use_fusion_emitters=false",)}


def set_threads(count: int) -> None:
    """Limit the threads of this process; to be called before JAX is loaded."""
    for variable in THREAD_VARIABLES:
        os.environ[variable] = str(count)


def choose_compiler_options() -> None:
    """Let XLA take the quicker of its two ways to compile for processors; before JAX computes anything.

    What it compiles runs as fast either way (``python -m benchmarks --only compile``). What the user has set
    in ``XLA_FLAGS`` stays.
    """
    series = version("jaxlib").rsplit(".", 1)[0]
    ours = [one for one in _COMPILER_OPTIONS.get(series, ()) if one.split("=")[0] not in _flags()]
    if ours:
        os.environ["XLA_FLAGS"] = " ".join([_flags(), *ours]).strip()


def _flags() -> str:
    return os.environ.get("XLA_FLAGS", "")


def set_up_jax() -> None:
    """Switch to 64 bits, compile quickly, and keep what is compiled for the next run."""
    choose_compiler_options()
    import jax

    from wrapjax.io.files import cache_folder

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(cache_folder("compiled")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def forget_if_crowded() -> None:
    """Let go of compiled programs if another subject might not find room beside them.

    Each compiles hundreds for its own sizes. Linux lets a process map only so many pieces of memory, and
    LLVM ends a process that it has none for.
    """
    import jax

    try:
        most = int(Path("/proc/sys/vm/max_map_count").read_text())
        with Path("/proc/self/maps").open(encoding="utf-8") as maps:
            crowded = sum(1 for _ in maps) > most // 3
    except (OSError, ValueError):
        return
    if crowded:
        jax.clear_caches()


def require_float64() -> None:
    """Raise unless JAX calculates in 64 bits.

    In 32 bits a fifth-degree polynomial loses a millimeter and a solver stops far from its optimum.
    The switch is the caller's: flipping it here would change the caller's other programs.
    """
    import jax

    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError(
            "wrapjax calculates in 64 bits, and JAX is set to 32: "
            'call jax.config.update("jax_enable_x64", True) before the first JAX operation'
        )
