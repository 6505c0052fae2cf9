"""Whom benchmarks calibrate, and JAX set up as commands set it up."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def set_up_jax() -> None:
    """Switch to 64 bits and keep compiled kernels for the next run."""
    import jax

    from wrapjax.files import cache_folder

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(cache_folder("compiled")))


@contextmanager
def default_subject(given: Path | None) -> Iterator[Path]:
    """Give the folder of a subject: the one asked for, a recorded one, or a virtual one made up for now."""
    if given:
        yield given
    elif os.environ.get("WRAPJAX_DATA"):
        yield Path(os.environ["WRAPJAX_DATA"]) / "s1_left"
    else:
        from wrapjax.virtual import write_virtual_subject

        with tempfile.TemporaryDirectory() as folder:
            write_virtual_subject(Path(folder) / "virtual")
            yield Path(folder) / "virtual"
