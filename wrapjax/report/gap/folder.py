"""The folder of a diagnosis, written whole or not at all."""

from __future__ import annotations

from pathlib import Path

from wrapjax.files import new_folder, write_json, write_text
from wrapjax.gap.result import GapResult
from wrapjax.report.gap.numbers import describe_gap, moment_table
from wrapjax.report.gap.page import render_gap
from wrapjax.report.summary import file_stems
from wrapjax.subject import Subject, write_storage


def write_gap(
    subject: Subject, result: GapResult, folder: Path, *, force: bool = False, note: str = ""
) -> None:
    """Write ``gap.json``, the moments of every recording and ``report.html``.

    Parameters
    ----------
    subject, result
        What was diagnosed, and what came of it.
    folder
        Where to; it appears when complete.
    force
        Replace a folder that exists.
    note
        A sentence about the data for the report.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set, or cannot be created.
    """
    with new_folder(folder, force=force) as gap:
        write_json(gap / "gap.json", describe_gap(subject, result))
        for recording, stem in file_stems(tuple(dict.fromkeys(result.recordings))).items():
            write_storage(gap / "moments" / f"{stem}.sto", moment_table(result, recording))
        write_text(gap / "report.html", render_gap(subject, result, note))
