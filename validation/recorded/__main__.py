"""Diagnosis of known errors added to recorded walking: ``python -m validation.recorded --out DIR``.

The recording is ``$WRAPJAX_DATA/s1_left`` (or ``--subject``). Injections (delay, drift, crosstalk, a spring,
each at half, once and twice the prior standard deviation) are scored in linearized models and compared with
the original recording: the increase of each effect's evidence, and whether that of the injected effect
increases most. Their calibrations start from the model's initial values and from the result of the original
recording. Knock-outs (a hidden electrode, a wrong mass, other filters) are diagnosed completely. One JSON
file for each variant is stored in DIR, so that an interrupted run can be continued; the table and
`summary.json` include all stored variants.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.machine import pin_threads
from validation.diagnosis.case_answers import calibration_fingerprint
from validation.recorded.injected_errors import Variant, injections, knock_outs, write_variant
from wrapjax.errors import InputError, Problem

ORIGINAL = Variant("untouched", "as it was recorded", list, None)
#: Magnitude for the target, and target share of cases in which the injected effect increases most.
LARGEST, TARGET = "2", 0.8


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    try:
        _run(options)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _run(options: argparse.Namespace) -> None:
    from wrapjax.subject.subject import load_subject

    injected, knocked = injections(load_subject(options.subject).side), knock_outs()
    selected = _select(options.only, [*injected, *knocked])
    # Import JAX after the arguments are checked.
    from validation.recorded.variant_results import diagnosed, scored
    from wrapjax.io.files import write_json
    from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax

    set_up_jax()
    source, starts = options.subject, options.starts
    options.out.mkdir(parents=True, exist_ok=True)
    before = _cached(ORIGINAL, options, partial(scored, starts=starts, beside=()))
    for variant in selected:
        if variant in injected:
            compute = partial(scored, starts=starts, beside=before["variables"])
        else:
            compute = partial(diagnosed, starts=starts, whole=source, hidden=variant.hidden)
        _cached(variant, options, compute)
        clear_caches_near_map_limit()
    found = ((one.name, _read_stored(one, options)) for one in [*injected, *knocked])
    # Results of another version of the package are not comparable.
    code = before["question"]["code"]
    kept = {name: one for name, one in found if one is not None and one["question"]["code"] == code}
    summary = summarize(before, [*injected, *knocked], kept)
    write_json(options.out / "summary.json", summary)
    print(as_text(summary), end="")


def _select(names: Sequence[str] | None, variants: Sequence[Variant]) -> list[Variant]:
    known = {one.name: one for one in variants}
    if unknown := [name for name in names or () if name not in known]:
        hint = f"there are {', '.join(known)}"
        raise InputError(Problem("--only", f"there is no variant '{unknown[0]}'", hint=hint))
    return [known[name] for name in names or known]


def _cached(
    variant: Variant, options: argparse.Namespace, compute: Callable[[Path], dict[str, Any]]
) -> dict[str, Any]:
    """Compute the result of a variant, or read it if its inputs are unchanged."""
    from wrapjax.io.files import write_json

    began = time.perf_counter()
    folder = options.out / "subjects" / variant.name
    write_variant(options.subject, folder, variant)
    question = {**calibration_fingerprint(folder), "starts": options.starts}
    kept = _read_stored(variant, options)
    if kept is None or kept["question"] != question:
        kept = {"question": question, **compute(folder)}
        write_json(options.out / f"{variant.name}.json", kept)
    seconds = time.perf_counter() - began
    print(f"{variant.name}: {variant.says} ({seconds:.0f} s)", file=sys.stderr, flush=True)
    return kept


def _read_stored(variant: Variant, options: argparse.Namespace) -> dict[str, Any] | None:
    file = options.out / f"{variant.name}.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else None


def summarize(
    before: Mapping[str, Any], variants: Sequence[Variant], kept: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Summarize all stored variants, and how often the evidence of the injected effect increased most."""
    rows = []
    for variant in variants:
        found = kept.get(variant.name)
        if found is None:
            continue
        row: dict[str, Any] = {"name": variant.name, "says": variant.says, "effect": variant.effect}
        if "evidence" in found:
            rise = {
                id: value - before["evidence"][id]
                for id, value in found["evidence"].items()
                if id in before["evidence"]
            }
            order = sorted(rise, key=lambda id: -rise[id])
            row |= {
                "rise": {id: rise[id] for id in order},
                "first": order[0],
                "place": order.index(variant.effect) + 1 if variant.effect in rise else None,
            }
        else:
            accepted = {*found["named"], *(id for tie in found["ties"] for id in tie)}
            row |= {key: found[key] for key in ("outcome", "named", "ties", "drive")}
            row["found"] = None if variant.effect is None else variant.effect in accepted
        rows.append(row)
    largest = [row["place"] for row in rows if "place" in row and row["name"].endswith(f"_{LARGEST}")]
    share = sum(place == 1 for place in largest) / len(largest) if largest else None
    return {"schema": 1, "rows": rows, "rose_most_at_twice": share, "of": len(largest), "target": TARGET}


def as_text(summary: Mapping[str, Any]) -> str:
    """Format Markdown tables of injections and knock-outs."""
    rows = summary["rows"]
    lines = [
        "| injected error | increase of its evidence (nats) | its rank | largest increase |",
        "|---|---|---|---|",
    ]
    for row in (row for row in rows if "rise" in row):
        own = row["rise"].get(row["effect"])
        rise = "not tested" if own is None else f"{own:+.1f}"
        first = f"`{row['first']}` {row['rise'][row['first']]:+.1f}"
        lines.append(f"| {row['says']} | {rise} | {row['place'] or '-'} | {first} |")
    if summary["of"]:
        share = f"{100 * summary['rose_most_at_twice']:.0f} % of {summary['of']}"
        said = f"At twice the prior standard deviation the injected effect increased most in {share}"
        lines += ["", f"{said} (target: {100 * summary['target']:.0f} %)."]
    drive = "excitation of its muscle group: correlation with EMG, with delay"
    lines += ["", f"| knocked out | outcome | {drive} |", "|---|---|---|"]
    for row in (row for row in rows if "outcome" in row):
        said = f"{row['outcome']} {', '.join(row['named'] or itertools.chain(*row['ties']))}".strip()
        lines.append(f"| {row['says']} | {said} | {_drive_text(row['drive'])} |")
    return "\n".join(lines) + "\n"


def _drive_text(drive: Mapping[str, Any] | None) -> str:
    if drive is None:
        return "-"
    places = [number for number, one in enumerate(drive["groups"], 1) if one["own"]]
    if not places:
        return "no group of the catalogue"
    own = drive["groups"][places[0] - 1]
    rank = f"{own['group']}, rank {places[0]} of {len(drive['groups'])} groups"
    if own["correlation"] is None:
        return f"no excitation ({rank})"
    return f"{own['correlation']:.2f}, {own['correlation_delayed']:.2f} ({rank})"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.recorded", description=__doc__)
    data = os.environ.get("WRAPJAX_DATA")
    parser.add_argument(
        "--subject",
        type=Path,
        default=Path(data) / "s1_left" if data else None,
        required=data is None,
        help="subject folder with separate files for every cycle (default: $WRAPJAX_DATA/s1_left)",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="variants to run (default: all)")
    parser.add_argument(
        "--starts",
        type=int,
        default=4,
        help="starts of each calibration (default: 4; a diagnosis requires two that agree)",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
