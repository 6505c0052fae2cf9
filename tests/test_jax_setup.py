"""Compiler options are those tested with the installed version, and options of the user are kept."""

import os
import platform
import subprocess
import sys

import pytest

import wrapjax.jax_setup
from wrapjax.jax_setup import choose_compiler_options

EMITTERS, LEVEL = "--xla_cpu_use_fusion_emitters", "--xla_backend_optimization_level"
EXTRA = "--xla_backend_extra_options=-disable-lsr=true,-vectorize-slp=false"
OURS = f"{EMITTERS}=false {LEVEL}=1 {EXTRA}"


@pytest.mark.parametrize(
    ("series", "before", "after"),
    [
        ("0.10.2", "", OURS),
        ("0.10.2", "--xla_dump_to=x", f"--xla_dump_to=x {OURS}"),
        ("0.10.2", f"{EMITTERS}=true", f"{EMITTERS}=true {LEVEL}=1 {EXTRA}"),
        ("0.10.2", f"{LEVEL}=3", f"{LEVEL}=3 {EMITTERS}=false {EXTRA}"),
        (
            "0.10.2",
            "--xla_backend_extra_options=-a",
            f"--xla_backend_extra_options=-a {EMITTERS}=false {LEVEL}=1",
        ),
        # Another version may not know it, and would end the process.
        ("0.99.0", "--xla_dump_to=x", "--xla_dump_to=x"),
    ],
)
def test_options_are_added_to_those_of_the_user(monkeypatch, series, before, after):
    monkeypatch.setattr(wrapjax.jax_setup, "version", lambda _: series)
    monkeypatch.setenv("XLA_FLAGS", before)
    choose_compiler_options()
    assert os.environ["XLA_FLAGS"] == after


def test_the_installed_version_accepts_them():
    """In a separate process without options, which an unknown option would end."""
    code = (
        "from wrapjax.jax_setup import set_up_jax as go; go(); import jax, os; print(jax.numpy.ones(2).sum())"
    )
    code += "; print(os.environ.get('XLA_FLAGS'))"
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and done.stdout.split() == ["2.0", *OURS.split()], done.stderr


def test_freed_memory_is_kept():
    """Blocks of 40 MB, which the C library would map and unmap each time, are cleared by the kernel once."""
    code = (
        "import sys, resource; from wrapjax.jax_setup import keep_freed_memory\n"
        "kept = keep_freed_memory() if sys.argv[1] == 'keep' else False\n"
        "for _ in range(10): b'x' * 40_000_000\n"
        "print(kept, resource.getrusage(resource.RUSAGE_SELF).ru_minflt)"
    )
    kept, not_kept = (
        subprocess.run(
            [sys.executable, "-c", code, mode], capture_output=True, text=True, check=True
        ).stdout.split()
        for mode in ("keep", "leave")
    )
    assert (kept[0] == "True") == (platform.libc_ver()[0] == "glibc")
    assert kept[0] == "False" or int(kept[1]) < 0.4 * int(not_kept[1])
