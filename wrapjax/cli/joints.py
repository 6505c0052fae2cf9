"""Command ``wrapjax joints``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from wrapjax.cli.common import DONE, NOT_CONVERGED, AddCommand, print_json, read_json
from wrapjax.cli.settings_file import add_settings
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    joints = command("joints", run, "Personalise joint frames, body scales and marker places from markers.")
    joints.add_argument(
        "source",
        type=Path,
        metavar="SETTINGS",
        help="laboratory settings with a table [joints] (TOML), a folder that holds joints.toml, or settings "
        "of the NMSM Pipeline's joint model personalization (XML)",
    )
    joints.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder")
    joints.add_argument(
        "--symmetric",
        action="store_true",
        help="one unknown for both sides: changes of joints and scales of the left are those of the right, "
        "mirrored",
    )
    add_settings(joints)


def joints_table(content: dict[str, Any]) -> str:
    """Tabulate marker errors, and the largest changes with their standard deviations."""
    rms = content["rms_mm"]
    lines = [f"{content['subject']}: {content['message']}", ""]
    lines.append(f"markers, root mean square on frames used: {rms['before']:.2f} -> {rms['after']:.2f} mm")
    if rms["held_out_before"] is not None:
        before, after = rms["held_out_before"], rms["held_out_after"]
        falls = "" if after < before else ", no better than before"
        lines.append(f"on frames held out: {before:.2f} -> {after:.2f} mm{falls}")
    lines += ["", f"{'joint':20s}{'frame':>8s}{'change':>52s}"]
    for name, joint in content["joints"].items():
        for unit, factor, word in (
            ("translation_m", 1e3, "mm"),
            ("orientation_rad", 57.29577951308232, "deg"),
        ):
            for side, axes in joint["change"].get(unit, {}).items():
                parts = [
                    f"{axis} {factor * value:+.1f} (sd {factor * joint['sd'][unit][side][axis]:.1f})"
                    + ("" if joint["determined"][unit][side][axis] else "?")
                    for axis, value in axes.items()
                ]
                lines.append(f"{name:20s}{side:>8s}  {word:4s}{', '.join(parts)}")
    if content["undetermined"]:
        lines += [
            "",
            f"? not determined by the markers: the prior holds ({len(content['undetermined'])} values)",
        ]
    return "\n".join(lines)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.joints.personalisation import personalize_joints, read_settings
    from wrapjax.progress import print_progress

    check_output_folder(options.out, options.force)
    settings = read_settings(options.source)
    if options.symmetric:
        settings = replace(settings, symmetric=True)
    done = personalize_joints(settings, log=lambda line: print_progress(line, quiet=options.quiet))
    print_progress("writing the report, and a page with the model in motion", quiet=options.quiet)
    done.save(options.out, force=options.force, motion=True)
    content = read_json(options.out / "joints.json")
    if options.json:
        print_json(content)
    else:
        print(joints_table(content))
        print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")
    return DONE if done.status.converged else NOT_CONVERGED
