"""How JAX is set up for long work. JAX is imported only when it is done: threads must be set before."""

from __future__ import annotations

import os
from pathlib import Path

#: What decides the thread counts of XLA and of the numerical libraries.
THREAD_VARIABLES = ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def set_threads(count: int) -> None:
    """Limit the threads of this process; to be called before JAX is loaded."""
    for variable in THREAD_VARIABLES:
        os.environ[variable] = str(count)


def set_up_jax() -> None:
    """Switch to 64 bits and keep compiled kernels for the next run."""
    import jax

    from wrapjax.files import cache_folder

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(cache_folder("compiled")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


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
