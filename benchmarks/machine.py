"""Machine, package versions and commit of a benchmark run."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

#: Environment variables that set the thread counts of XLA and of the numerical libraries.
THREAD_VARIABLES = ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_PACKAGES = ("wrapjax", "jax", "jaxlib", "equinox", "numpy", "scipy", "opensim", "optimistix", "jaxopt")


def pin_threads(count: int = 1) -> None:
    """Set the number of threads of all numerical libraries.

    Must be called before any of them is imported.
    """
    for variable in THREAD_VARIABLES:
        os.environ[variable] = str(count)


def describe_machine() -> dict[str, Any]:
    """Describe processor, cores, threads, load and system."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "threads": {variable: os.environ.get(variable) for variable in THREAD_VARIABLES},
        "load_average": os.getloadavg()[0],
        "system": platform.platform(),
        "python": platform.python_version(),
    }


def versions() -> dict[str, str | None]:
    """Return the versions of the compared packages; None where one is missing."""
    return {name: _version(name) for name in _PACKAGES}


def commit() -> str | None:
    """Return the current commit, with a plus if tracked files differ from it; None outside git."""
    here = Path(__file__).parent
    try:
        name, changed = (
            subprocess.run(
                ["git", "-C", here, *words], capture_output=True, text=True, check=True
            ).stdout.strip()
            for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return name + ("+" if changed else "")


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def processor() -> str:
    """Return the processor's model name."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor()
