"""Command ``wrapjax report``: rendering of stored results, and an index of many results."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.cli.common import DONE, AddCommand, print_json
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_text


def redraw(folder: str | Path) -> Path:
    """Render the report of an evaluation or a cohort again, or an index of results.

    Parameters
    ----------
    folder
        Folder of an evaluation or a cohort, whose ``report.html`` is rendered again; or a folder that
        contains results, in which an ``index.html`` with a line and a link for each is written.

    Returns
    -------
    Path
        File of the page.

    Raises
    ------
    InputError
        If the folder does not exist, contains no result, or is a result that does not store all that its
        report needs.
    """
    from wrapjax.cohorts.cohort import redraw_cohort
    from wrapjax.report.calibration.evaluation_page import redraw_evaluation
    from wrapjax.report.overview import find_results, kind_of, refuse_redrawing, render_overview

    place = Path(folder)
    if not place.is_dir():
        message = "is a file, where a folder was expected" if place.exists() else "does not exist"
        raise InputError(Problem(str(place), message))
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
    report = command(
        "report",
        run,
        "Render the report of an evaluation or a cohort again, or an index of all results in a folder.",
    )
    report.add_argument(
        "folder",
        type=Path,
        metavar="DIR",
        help="folder of an evaluation or a cohort, or a folder that contains results",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    page = redraw(options.folder)
    if options.json:
        print_json({"page": str(page)})
    else:
        print(f"written: {page}; open it in a browser")
    return DONE
