"""Settings of JAX: threads, compiler options, 64-bit precision and the cache of compiled programs.

JAX is imported only inside the functions, because thread counts must be set before it is loaded.
"""

from __future__ import annotations

import ctypes
import gc
import os
from importlib.metadata import version
from pathlib import Path

#: Environment variables that set the thread counts of XLA and of the numerical libraries.
THREAD_VARIABLES = ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")

#: XLA options by the series of jaxlib that they were tested with: XLA ends the process on an unknown option.
_COMPILER_OPTIONS = {
    "0.10": (
        "--xla_cpu_use_fusion_emitters=false",
        "--xla_backend_optimization_level=1",
        "--xla_backend_extra_options=-disable-lsr=true,-vectorize-slp=false",
    ),
}

#: New objects, and collections of younger ones, after which Python searches for unused cycles.
_GARBAGE_THRESHOLDS = (200_000, 50, 50)


def set_threads(count: int) -> None:
    """Limit the number of threads of this process; call it before JAX is loaded."""
    for variable in THREAD_VARIABLES:
        os.environ[variable] = str(count)


def choose_compiler_options() -> None:
    """Select the faster of XLA's two compilers for processors; call it before the first JAX operation.

    Compiled programs run as fast as by XLA's own options (``python -m benchmarks --only compile``). LLVM's
    first level saves an eighth of the compilation of NGA and next to nothing of that of SGA. Without LLVM's
    rewriting of addresses in loops (LSR) and vectorizing of straight-line code (SLP) SGA is compiled in 17 %
    less processor time. Its vectorizing of loops stays: paths round cylinders take twice as long without it.
    Level 0 would take half the time, but its programs run up to three times as long, and some have returned
    NaN. Options that the user has set in ``XLA_FLAGS`` are kept.
    """
    series = version("jaxlib").rsplit(".", 1)[0]
    added = [
        option for option in _COMPILER_OPTIONS.get(series, ()) if option.split("=")[0] not in _xla_flags()
    ]
    if added:
        os.environ["XLA_FLAGS"] = " ".join([_xla_flags(), *added]).strip()


def keep_freed_memory() -> bool:
    """Let the C library keep freed memory for the next program; call it before JAX is loaded.

    XLA allocates the buffers of a program each time it runs. The GNU C library returns large ones to the
    kernel, which clears them page by page on the next use: a fifth of the time of a calibration by SGA. With
    one arena, no memory maps and no trimming it keeps them, and the process stays as large as it once was.

    Returns
    -------
    bool
        Whether the C library took the settings; other libraries than GNU's do not have them.
    """
    try:
        adjust = ctypes.CDLL("libc.so.6").mallopt
    except (OSError, AttributeError):
        return False
    # Numbers of malloc.h: M_ARENA_MAX, M_MMAP_MAX, M_TRIM_THRESHOLD. Each call returns 1 on success.
    settings = {-8: 1, -4: 0, -1: 2**31 - 1}
    return all([adjust(name, value) for name, value in settings.items()])


def collect_garbage_less_often() -> None:
    """Raise the number of new objects at which Python searches for cycles of unused ones.

    Tracing a program makes millions of objects that stay until it is compiled, and Python's default, 700,
    searches them again and again: up to a tenth of the time before a first result.
    """
    gc.set_threshold(*_GARBAGE_THRESHOLDS)


def _xla_flags() -> str:
    return os.environ.get("XLA_FLAGS", "")


def set_up_jax() -> None:
    """Enable 64-bit precision, fast compilation, the cache of compiled programs on disk, and kept memory."""
    keep_freed_memory()
    collect_garbage_less_often()
    choose_compiler_options()
    import jax

    from wrapjax.io.files import cache_folder

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(cache_folder("compiled")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def clear_caches_near_map_limit() -> None:
    """Discard compiled programs if this process nears Linux's limit of memory maps.

    Each subject compiles hundreds of programs for its own array sizes. Every program takes memory maps, whose
    number per process Linux limits (``vm.max_map_count``), and LLVM ends the process when none is available.
    """
    import jax

    try:
        limit = int(Path("/proc/sys/vm/max_map_count").read_text())
        with Path("/proc/self/maps").open(encoding="utf-8") as maps:
            near_limit = sum(1 for _ in maps) > limit // 3
    except (OSError, ValueError):
        return
    if near_limit:
        jax.clear_caches()


def require_float64() -> None:
    """Raise an error unless JAX is in 64-bit mode.

    In single precision a fifth-degree polynomial is off by a millimeter, and a solver stops far from its
    optimum. The mode is not switched here, because that would change the caller's other JAX programs.

    Raises
    ------
    RuntimeError
        If JAX is in 32-bit mode.
    """
    import jax

    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError(
            "wrapjax calculates in 64 bits, and JAX is set to 32: "
            "call wrapjax.set_up_jax() before the first JAX operation"
        )
