"""The commands. Results go to standard output, progress to standard error.

Exit status: 0 done and converged, 1 ran but did not converge, 2 bad input or usage.

The commands, one module each: `add` puts it on the parser, `run` does it.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

from wrapjax.cli import (
    calibrate,
    check,
    cohort,
    compare,
    contact,
    demo,
    diagnose,
    evaluate,
    fetch,
    fit,
    initialise,
    prepare,
    report,
)
from wrapjax.cli.common import BAD_INPUT, NOT_CONVERGED, positive_integer
from wrapjax.cli.settings import add_settings, apply_settings, keep_settings
from wrapjax.errors import InputError, WorkError
from wrapjax.io.locks import lock_folder
from wrapjax.jax_setup import set_threads

#: Each adds its command to the parser; in the order that ``wrapjax --help`` shows them.
ADDED = (
    check.add,
    prepare.add,
    fit.add,
    initialise.add,
    calibrate.add,
    compare.add,
    diagnose.add,
    demo.add,
    fetch.add,
    evaluate.add,
    report.add,
    contact.add,
    cohort.add,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A terminal that lacks a letter of somebody's name shows its code instead of failing.
        sys.stdout.reconfigure(errors="backslashreplace")
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser, commands = _parser()
    try:
        name = words[0] if words else ""
        if name in commands:
            apply_settings(commands[name], name, words[1:])
        options = parser.parse_args(words)
        if options.threads is not None:
            set_threads(options.threads)
        out = getattr(options, "out", None)
        with nullcontext() if out is None else lock_folder(out):
            status = options.run(options)
            keep_settings(commands[name], name, options)
        return status
    except InputError as error:
        for problem in error.problems:
            print(f"error: {problem}", file=sys.stderr)
        if len(error.problems) > 1:
            print(f"{len(error.problems)} problems found; nothing was written.", file=sys.stderr)
        return BAD_INPUT
    except WorkError as error:
        print(f"error: {error}; nothing was written.", file=sys.stderr)
        return NOT_CONVERGED
    except MemoryError:
        print("error: there is not enough memory for this; nothing was written.", file=sys.stderr)
        return NOT_CONVERGED
    except OSError as error:
        place = error.filename or "file"
        print(f"error: {place}: {error.strerror or error}; nothing was written.", file=sys.stderr)
        return BAD_INPUT
    except RuntimeError as error:
        # As XLA says it, whose own errors can be caught by name only with JAX loaded.
        if not str(error).startswith("RESOURCE_EXHAUSTED"):
            raise
        print("error: there is not enough memory for this; nothing was written.", file=sys.stderr)
        return NOT_CONVERGED
    except KeyboardInterrupt:
        print("interrupted; nothing was written.", file=sys.stderr)
        return NOT_CONVERGED


def _parser() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """Build the parser, and give those of the commands by name."""
    parser = argparse.ArgumentParser(
        prog="wrapjax", description="Calibrate EMG-driven musculoskeletal models with exact gradients."
    )
    parser.add_argument("--version", action="version", version=_version())
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "--threads", type=positive_integer, metavar="N", help="processor cores to use (default: all)"
    )
    common.add_argument("--quiet", action="store_true", help="print no progress")
    common.add_argument("--json", action="store_true", help="print the result as JSON")
    common.add_argument("--seed", type=int, default=0, metavar="N", help="of everything random (default: 0)")
    common.add_argument("--force", action="store_true", help="replace the folder if it exists")
    common.add_argument(
        "--resume",
        action="store_true",
        help="go on with interrupted work of the same folder, if there is any",
    )
    writing = argparse.ArgumentParser(add_help=False)
    add_settings(writing)
    parsers: dict[str, argparse.ArgumentParser] = {}

    def command(name: str, run: Any, help: str, *parents: argparse.ArgumentParser) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=help, description=help, parents=[common, *parents])
        added.set_defaults(run=run)
        parsers[name] = added
        return added

    for add in ADDED:
        add(command, writing)
    return parser, parsers


def _version() -> str:
    from wrapjax import __version__

    return f"wrapjax {__version__}"


if __name__ == "__main__":
    sys.exit(main())
