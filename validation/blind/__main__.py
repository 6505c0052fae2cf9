"""Commands of the blind bank: ``python -m validation.blind COMMAND``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from validation.blind.case_selection import add_selection_arguments, selection_of
from validation.blind.plan import BANK_SIZES, WORLD_BANK, banks_of
from validation.blind.worlds import WORLDS


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m validation.blind", description="Make, check and score the blind bank."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser(
        "make", help="simulate the cases of a bank and write their hashes; continues an interrupted run"
    )
    make.add_argument("--bank", choices=sorted({*BANK_SIZES, WORLD_BANK}), default="development")
    make.add_argument("--world", choices=list(WORLDS), help=f"make only one world of bank {WORLD_BANK}")
    make.add_argument("--cases", type=int, help="size of a smaller bank with the same proportions")
    add_selection_arguments(make)
    make.add_argument("--workers", type=int, default=1)
    make.add_argument("--out", type=Path, required=True)
    conditions = commands.add_parser(
        "conditions", help="let the people of a bank walk with and without the cause of their case"
    )
    conditions.add_argument("--bank", choices=sorted({*BANK_SIZES, WORLD_BANK}), default=WORLD_BANK)
    conditions.add_argument("--world", choices=list(WORLDS), help=f"one world of bank {WORLD_BANK}")
    conditions.add_argument("--cases", type=int, help="size that the bank was made with")
    conditions.add_argument("--made", type=Path, required=True, metavar="DIR", help="folder of the bank")
    conditions.add_argument("--out", type=Path, required=True)
    score = commands.add_parser("score", help="score answers against the true causes")
    score.add_argument("--bank", type=Path, required=True, help="folder of the bank")
    score.add_argument("--manifest", type=Path, help="committed manifest (default: that of the bank)")
    score.add_argument("--answers", action="append", required=True, metavar="NAME=FOLDER")
    score.add_argument("--withheld", action="append", default=[], metavar="NAME=FOLDER")
    add_selection_arguments(score)
    score.add_argument("--json", type=Path, help="file to write all figures to")
    check = commands.add_parser("check", help="compare a bank with its manifest byte for byte")
    check.add_argument("--bank", type=Path, required=True, help="folder of the bank")
    check.add_argument("--manifest", type=Path, help="committed manifest (default: that of the bank)")
    add_selection_arguments(check)
    publish = commands.add_parser("publish", help="write a table and two figures of a score")
    publish.add_argument(
        "--score", type=Path, required=True, metavar="FILE", help="file written by 'score --json'"
    )
    publish.add_argument("--of", metavar="NAME", help="answerer to publish (default: the first)")
    publish.add_argument("--out", type=Path, required=True, metavar="DIR")
    sheet = commands.add_parser("sheet", help="plot the signals of several cases on one page")
    sheet.add_argument("--bank", type=Path, required=True)
    sheet.add_argument("--out", type=Path, required=True)
    sheet.add_argument("--count", type=int, default=8)
    commands.add_parser("forms", help="print the table of simulated effects")
    chosen = parser.parse_args(arguments)
    run = {
        "make": _make,
        "conditions": _conditions,
        "check": _check,
        "score": _score,
        "publish": _publish,
        "sheet": _sheet,
        "forms": _forms,
    }
    return run[chosen.command](chosen)


def _make(chosen: argparse.Namespace) -> int:
    from validation.blind.make import make

    try:
        banks = banks_of(chosen.bank, chosen.cases, chosen.world)
    except ValueError as reason:
        print(reason, file=sys.stderr)
        return 1
    planned = make(banks, chosen.out, chosen.workers, selection_of(chosen))
    print(f"{len(planned)} cases in {chosen.out}, sealed by {chosen.out / 'manifest.json'}")
    return 0


def _conditions(chosen: argparse.Namespace) -> int:
    from validation.blind.conditions import make_pairs

    try:
        banks = banks_of(chosen.bank, chosen.cases, chosen.world)
    except ValueError as reason:
        print(reason, file=sys.stderr)
        return 1
    count = make_pairs(banks, chosen.made, chosen.out)
    if not count:
        print(
            f"{chosen.made}: no case of these banks that has a pair; was it made with --cases?",
            file=sys.stderr,
        )
        return 1
    print(f"{count} pairs in {chosen.out}")
    return 0


def _score(chosen: argparse.Namespace) -> int:
    from validation.blind.score.report import NotReady, as_json, as_markdown, score

    pairs = lambda words: {name: Path(folder) for name, folder in (word.split("=", 1) for word in words)}  # noqa: E731
    try:
        result = score(
            chosen.bank, pairs(chosen.answers), pairs(chosen.withheld), chosen.manifest, selection_of(chosen)
        )
    except NotReady as reason:
        print(reason, file=sys.stderr)
        return 1
    if chosen.json:
        chosen.json.write_text(as_json(result), encoding="utf-8")
    print(as_markdown(result), end="")
    return 0


def _check(chosen: argparse.Namespace) -> int:
    from validation.blind.seal import broken_seals

    manifest = chosen.manifest or chosen.bank / "manifest.json"
    if not manifest.is_file():
        print(f"{manifest}: no such manifest", file=sys.stderr)
        return 1
    faults = broken_seals(chosen.bank, manifest, selection_of(chosen))
    for line in faults:
        print(line)
    print(f"{len(faults)} differ" if faults else f"{chosen.bank} is the sealed bank, byte for byte")
    return 1 if faults else 0


def _publish(chosen: argparse.Namespace) -> int:
    from validation.blind.publish.pictures import draw_confusion, draw_curves
    from validation.blind.publish.scores import Unreadable, read_scores
    from validation.blind.publish.table import as_table

    try:
        scores = read_scores(chosen.score, chosen.of)
    except Unreadable as reason:
        print(reason, file=sys.stderr)
        return 1
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "table.md").write_text(as_table(scores), encoding="utf-8", newline="\n")
    draw_curves(scores, chosen.out / "right.png")
    draw_confusion(scores[0], chosen.out / "families.png")
    print(f"table.md, right.png and families.png are in {chosen.out}")
    return 0


def _sheet(chosen: argparse.Namespace) -> int:
    from validation.blind.case_plots import draw_cases

    draw_cases(chosen.bank, chosen.out, chosen.count)
    return 0


def _forms(chosen: argparse.Namespace) -> int:
    from validation.blind.effect_table import effect_table

    print(effect_table(), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
