"""``wrapjax report``.

``report``: pages drawn again from what is stored, and an index over many results.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.cli.common import DONE, AddCommand, print_json
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_text


def redraw(folder: str | Path) -> Path:
    """Draw the report of a result again, or an index of the results below a folder.

    Parameters
    ----------
    folder
        Of an evaluation or a cohort: its ``report.html`` is drawn again. Of anything else that holds
        results: an ``index.html`` is written there, one line and link each.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If the folder is a result whose report needs what is not stored, or holds no result at all.
    """
    from wrapjax.cohorts.cohort import redraw_cohort
    from wrapjax.report.evaluation_page import redraw_evaluation
    from wrapjax.report.overview import find_results, kind_of, refuse_redrawing, render_overview

    place = Path(folder)
    if not place.is_dir():
        found = "is a file, where a folder was expected" if place.exists() else "does not exist"
        raise InputError(Problem(str(place), found))
    kind = kind_of(place)
    redrawn = {"evaluation": redraw_evaluation, "cohort": redraw_cohort}
    if kind in redrawn:
        redrawn[kind](place)
        return place / "report.html"
    if kind is not None:
        refuse_redrawing(place, kind)
    results = find_results(place)
    if not results:
        raise InputError(Problem(str(place), "holds no result of wrapjax, nor does any folder below it"))
    write_text(place / "index.html", render_overview(place, results))
    return place / "index.html"


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    report = command("report", run, "Draw a report again from what is stored, or an index of results.")
    report.add_argument("folder", type=Path, metavar="DIR", help="a result, or what holds several")


def run(options: argparse.Namespace) -> int:
    """Run the command."""

    page = redraw(options.folder)
    if options.json:
        print_json({"page": str(page)})
    else:
        print(f"written: {page}; open it in a browser")
    return DONE
