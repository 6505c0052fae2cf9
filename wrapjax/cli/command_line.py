"""Entry point of the ``wrapjax`` command line: parsing, exit statuses and error messages.

Results go to standard output, progress to standard error. Exit status: 0 finished and converged, 1 not
converged, interrupted or failed, 2 invalid input or usage. Each command is a module with two functions: `add`
adds it to the parser, and `run` runs it.
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
    ik,
    initialise,
    joints,
    paths,
    prepare,
    protocol,
    report,
    show,
)
from wrapjax.cli.common import BAD_INPUT, NOT_CONVERGED, positive_integer
from wrapjax.cli.settings_file import add_settings, apply_settings, save_settings
from wrapjax.errors import ComputationError, InputError
from wrapjax.io.files import lock_folder
from wrapjax.jax_setup import set_threads

#: Functions that add a command to the parser, in the order of ``wrapjax --help``.
ADD_COMMANDS = (
    check.add,
    prepare.add,
    ik.add,
    joints.add,
    fit.add,
    initialise.add,
    calibrate.add,
    compare.add,
    diagnose.add,
    protocol.add,
    demo.add,
    fetch.add,
    evaluate.add,
    report.add,
    show.add,
    contact.add,
    cohort.add,
    paths.add,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    arguments
        Command-line arguments; by default those of this process.

    Returns
    -------
    int
        Exit status.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A character that the terminal's encoding lacks is printed as its code instead of raising an error.
        sys.stdout.reconfigure(errors="backslashreplace")
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser, commands = build_parser()
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
            save_settings(commands[name], name, options)
        return status
    except InputError as error:
        for problem in error.problems:
            print(f"error: {problem}", file=sys.stderr)
        if len(error.problems) > 1:
            print(f"{len(error.problems)} problems found; nothing was written.", file=sys.stderr)
        return BAD_INPUT
    except ComputationError as error:
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
        # XLA's out-of-memory error; its class could be named here only with JAX loaded.
        if not str(error).startswith("RESOURCE_EXHAUSTED"):
            raise
        print("error: there is not enough memory for this; nothing was written.", file=sys.stderr)
        return NOT_CONVERGED
    except KeyboardInterrupt:
        print("interrupted; nothing was written.", file=sys.stderr)
        return NOT_CONVERGED


def build_parser() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """Build the parser, and return it with the parsers of the commands by name."""
    parser = argparse.ArgumentParser(
        prog="wrapjax",
        description="Calibrate EMG-driven musculoskeletal models to recorded gait with exact gradients, and "
        "diagnose what explains their remaining error. 'wrapjax COMMAND --help' describes a command.",
    )
    parser.add_argument("--version", action="version", version=_version())
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "--threads",
        type=positive_integer,
        metavar="N",
        help="number of processor cores to use (default: all)",
    )
    common.add_argument("--quiet", action="store_true", help="print no progress to standard error")
    common.add_argument("--json", action="store_true", help="print the result as JSON instead of a table")
    common.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the random number generators (default: 0)"
    )
    common.add_argument("--force", action="store_true", help="replace the output folder if it exists")
    common.add_argument(
        "--resume",
        action="store_true",
        help="continue an interrupted run with the same output folder, if the command keeps checkpoints",
    )
    writing = argparse.ArgumentParser(add_help=False)
    add_settings(writing)
    parsers: dict[str, argparse.ArgumentParser] = {}

    def command(name: str, run: Any, help: str, *parents: argparse.ArgumentParser) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=help, description=help, parents=[common, *parents])
        added.set_defaults(run=run)
        parsers[name] = added
        return added

    for add in ADD_COMMANDS:
        add(command, writing)
    return parser, parsers


def _version() -> str:
    from wrapjax import __version__

    return f"wrapjax {__version__}"


if __name__ == "__main__":
    sys.exit(main())
