"""Settings and fixtures that every test shares."""

import gc
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


#: Files whose tests take longest: begun first, so that no worker is left alone with one at the end.
LONGEST = (
    "tests/diagnosis/test_diagnosis.py",
    "tests/path_sources/test_wraps.py",
    "tests/cli/test_demo.py",
    "tests/comparison/test_comparison.py",
    "tests/path_sources/test_exact.py",
    "tests/diagnosis/test_task_evidence.py",
    "tests/notebooks",
    "tests/calibration/test_augmented_lagrangian.py",
    "tests/calibration/test_objective.py",
)


def pytest_collection_modifyitems(items):
    """Put the longest files first; within a file, and among the others, order stays."""

    def place(item) -> int:
        path = item.path.as_posix()
        return next((number for number, part in enumerate(LONGEST) if part in path), len(LONGEST))

    items.sort(key=place)


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory):
    """Keep the user's cache out of the tests and the tests out of the user's cache."""
    previous = os.environ.get("WRAPJAX_CACHE")
    os.environ["WRAPJAX_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if previous is None:
        del os.environ["WRAPJAX_CACHE"]
    else:
        os.environ["WRAPJAX_CACHE"] = previous


def pytest_sessionstart():
    """Compile as commands do; not sooner, for jaxtyping wants to be there before any of the package."""
    from wrapjax.jax_setup import (
        choose_compiler_options,
        collect_garbage_less_often,
        keep_freed_memory,
    )

    keep_freed_memory()
    collect_garbage_less_often()
    choose_compiler_options()
    # Most programs of tests run few times: they need no vector instructions in loops, whose search takes a
    # fifth of the time to compile them.
    options, slp = os.environ.get("XLA_FLAGS", ""), "-vectorize-slp=false"
    os.environ["XLA_FLAGS"] = options.replace(slp, f"{slp},-vectorize-loops=false")


@pytest.fixture(scope="session", autouse=True)
def compiled(cache, tmp_path_factory):
    """Keep compiled programs on disk, where commands keep them: modules that need the same one share it.

    So do the processes that tests run in. One may read what another is still writing: that is compiled anew.
    """
    from wrapjax.io.files import cache_folder

    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = tmp_path_factory.getbasetemp().parent / "compiled"
        shared.mkdir(exist_ok=True)
        (Path(os.environ["WRAPJAX_CACHE"]) / "compiled").symlink_to(shared, target_is_directory=True)
    jax.config.update("jax_compilation_cache_dir", str(cache_folder("compiled")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


#: Memory mappings of a process above which compiled programs are unloaded; Linux allows 65,530.
MOST_MAPPINGS = 20_000


@pytest.fixture(scope="module", autouse=True)
def forgotten(compiled):
    """Unload compiled programs before all together they use up a process's memory mappings.

    Not after each module, since the next one often needs the same programs.
    """
    yield
    mappings = Path("/proc/self/maps")
    if not mappings.exists() or len(mappings.read_bytes().splitlines()) > MOST_MAPPINGS:
        jax.clear_caches()
        gc.collect()


def _folder_from(variable: str) -> Path:
    value = os.environ.get(variable)
    if not value:
        pytest.skip(f"{variable} is not set: recorded data are not part of the project")
    return Path(value)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of recorded subjects."""
    return _folder_from("WRAPJAX_DATA")


@pytest.fixture(scope="session")
def s1_left(data_folder) -> Path:
    """A post-stroke adult, left leg: 34 muscles, 16 channels, 8 gait cycles."""
    return data_folder / "s1_left"


@pytest.fixture(scope="session")
def golden_folder() -> Path:
    """A peer's own input and output vectors."""
    return _folder_from("WRAPJAX_GOLDEN")
