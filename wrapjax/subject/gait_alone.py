"""A subject without its tasks other than gait, for methods that compare gait cycles phase by phase."""

from __future__ import annotations

from dataclasses import replace

from wrapjax.errors import InputError, Problem
from wrapjax.subject.settings import SETTINGS_FILE
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import GAIT


def with_gait_alone(subject: Subject, purpose: str) -> Subject:
    """Return the subject with its gait trials, and a note that names the trials left out.

    Parameters
    ----------
    subject
        Subject from `load_subject`.
    purpose
        What uses gait cycles alone, for the note and the message.

    Raises
    ------
    InputError
        If there is no gait cycle.
    """
    left_out = [entry.name for entry in subject.recordings if entry.task != GAIT]
    if not left_out:
        return subject
    trials = subject.trials.only_gait()
    if not len(trials):
        tasks = ", ".join(dict.fromkeys(entry.task for entry in subject.recordings))
        message = f"expected gait cycles, which {purpose} needs, found trials of {tasks} alone"
        raise InputError(Problem(str(subject.folder / SETTINGS_FILE), message, "[[trial]] task"))
    kept = [place for place, entry in enumerate(subject.recordings) if entry.task == GAIT]
    note = f"{purpose} uses gait cycles alone, without {', '.join(left_out)}"
    return replace(
        subject,
        trials=trials,
        recordings=tuple(subject.recordings[place] for place in kept),
        emg_rates=tuple(subject.emg_rates[place] for place in kept),
        notes=(*subject.notes, note),
    )
