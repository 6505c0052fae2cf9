"""``report``: pages drawn again from what is stored, and an index over many results."""

from __future__ import annotations

from pathlib import Path

from wrapjax.errors import InputError, Problem
from wrapjax.files import write_text


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
    from wrapjax.api.cohorts.running import redraw_cohort
    from wrapjax.report.evaluation.folder import redraw_evaluation
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
