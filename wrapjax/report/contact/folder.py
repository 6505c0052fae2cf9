"""The folder of contact forces, written whole or not at all."""

from __future__ import annotations

from pathlib import Path

from wrapjax.contact.result import ContactResult
from wrapjax.files import new_folder, write_json, write_text
from wrapjax.report.contact.numbers import describe_contact, force_table, undriven_tables
from wrapjax.report.contact.page import render_contact
from wrapjax.report.summary import file_stems
from wrapjax.subject import write_storage


def write_contact(result: ContactResult, folder: Path, *, force: bool = False) -> None:
    """Write ``contact.json``, the curves of every run and cycle, and ``report.html``.

    Parameters
    ----------
    result
        What was found.
    folder
        Where to; it appears when complete.
    force
        Replace a folder that exists.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set, or cannot be created.
    """
    with new_folder(folder, force=force) as place:
        write_json(place / "contact.json", describe_contact(result))
        labels = file_stems(tuple(run.label for run in result.runs))
        for run in result.runs:
            for trial, stem in enumerate(file_stems(result.trials).values()):
                name = f"{stem}.sto"
                write_storage(place / "forces" / labels[run.label] / name, force_table(result, run, trial))
                for kind, table in undriven_tables(result, run, trial).items():
                    write_storage(place / kind / labels[run.label] / name, table)
        write_text(place / "report.html", render_contact(result))
