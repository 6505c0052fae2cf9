"""``python -m validation.blind make|check|score|publish|sheet|forms``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from validation.blind.case_selection import add_lot, lot_of
from validation.blind.plan import BANK_SIZES, bank_of


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m validation.blind", description="The blind bank.")
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("make", help="make a bank's cases and seal them; resumes")
    make.add_argument("--bank", choices=sorted(BANK_SIZES), default="development")
    make.add_argument("--cases", type=int, help="a small bank of the same make-up")
    add_lot(make)
    make.add_argument("--workers", type=int, default=1)
    make.add_argument("--out", type=Path, required=True)
    score = commands.add_parser("score", help="judge answers against the sealed truth")
    score.add_argument("--bank", type=Path, required=True, help="folder of the bank")
    score.add_argument("--manifest", type=Path, help="the committed one, if not the bank's own")
    score.add_argument("--answers", action="append", required=True, metavar="NAME=FOLDER")
    score.add_argument("--withheld", action="append", default=[], metavar="NAME=FOLDER")
    add_lot(score)
    score.add_argument("--json", type=Path, help="write all figures here")
    check = commands.add_parser("check", help="whether a bank is the sealed one, byte for byte")
    check.add_argument("--bank", type=Path, required=True, help="folder of the bank")
    check.add_argument("--manifest", type=Path, help="the committed one, if not the bank's own")
    add_lot(check)
    publish = commands.add_parser("publish", help="a table and pictures for a README, of what was scored")
    publish.add_argument("--score", type=Path, required=True, metavar="FILE", help="of 'score --json'")
    publish.add_argument("--of", metavar="NAME", help="who is published (default: the first)")
    publish.add_argument("--out", type=Path, required=True, metavar="DIR")
    sheet = commands.add_parser("sheet", help="draw a contact sheet of cases")
    sheet.add_argument("--bank", type=Path, required=True)
    sheet.add_argument("--out", type=Path, required=True)
    sheet.add_argument("--count", type=int, default=8)
    commands.add_parser("forms", help="print the table of forms")
    chosen = parser.parse_args(arguments)
    run = {
        "make": _make,
        "check": _check,
        "score": _score,
        "publish": _publish,
        "sheet": _sheet,
        "forms": _forms,
    }
    return run[chosen.command](chosen)


def _make(chosen: argparse.Namespace) -> int:
    from validation.blind.make import make

    planned = make(bank_of(chosen.bank, chosen.cases), chosen.out, chosen.workers, lot_of(chosen))
    print(f"{len(planned)} cases in {chosen.out}, sealed by {chosen.out / 'manifest.json'}")
    return 0


def _score(chosen: argparse.Namespace) -> int:
    from validation.blind.score.report import NotReady, as_json, as_markdown, score

    pairs = lambda words: {name: Path(folder) for name, folder in (word.split("=", 1) for word in words)}  # noqa: E731
    try:
        result = score(
            chosen.bank, pairs(chosen.answers), pairs(chosen.withheld), chosen.manifest, lot_of(chosen)
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
    found = broken_seals(chosen.bank, manifest, lot_of(chosen))
    for line in found:
        print(line)
    print(f"{len(found)} differ" if found else f"{chosen.bank} is the sealed bank, byte for byte")
    return 1 if found else 0


def _publish(chosen: argparse.Namespace) -> int:
    from validation.blind.publish.pictures import draw_confusion, draw_right
    from validation.blind.publish.scores import Unreadable, read_scores
    from validation.blind.publish.table import as_table

    try:
        judged = read_scores(chosen.score, chosen.of)
    except Unreadable as reason:
        print(reason, file=sys.stderr)
        return 1
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "table.md").write_text(as_table(judged), encoding="utf-8", newline="\n")
    draw_right(judged, chosen.out / "right.png")
    draw_confusion(judged[0], chosen.out / "families.png")
    print(f"table.md, right.png and families.png are in {chosen.out}")
    return 0


def _sheet(chosen: argparse.Namespace) -> int:
    from validation.blind.case_plots import draw_sheet

    draw_sheet(chosen.bank, chosen.out, chosen.count)
    return 0


def _forms(chosen: argparse.Namespace) -> int:
    from validation.blind.effect_table import forms_text

    print(forms_text(), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
