"""Report of ``wrapjax check``: each finding in the recordings with a figure that shows it, and all cycles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.signal import welch

from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.io.storage import Storage, component_name, find_columns, read_storage
from wrapjax.preprocessing.checks.recording_findings import RESIDUAL_FORCE, RESIDUAL_MOMENT, Finding
from wrapjax.report import markup
from wrapjax.report.cycle_panels import label_gait_cycles
from wrapjax.report.formatting import counted, leg_name
from wrapjax.report.preparation_page import cycles_section, tables_section
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    PAGE_WIDTH,
    PALE_BLUE,
    VERMILION,
    Axes,
    Figure,
    draw_zero_line,
    in_style,
    legend_above,
    panel_grid,
)
from wrapjax.subject.description import Table, tables_content
from wrapjax.subject.emg_envelopes import sampling_rate
from wrapjax.subject.subject import Subject
from wrapjax.subject.trial_settings import TrialSettings
from wrapjax.subject.trials import GAIT

#: Time shown before and after the first sample at the extreme, s.
_AROUND = 0.5
#: Frequencies shown of a channel with mains residue, Hz.
_SPECTRUM = (5.0, 130.0)
_CAPTIONS = {
    "saturation": "The recorded signal around its first sample at the extreme (dashed).",
    "mains": "Power spectrum of the recorded signal (Welch); dashed: 50 and 60 Hz.",
    "pelvis residual": "What inverse dynamics left at the pelvis, over all cycles; shaded: up to the limit.",
}
_OF_CYCLES = (
    "EMG over the gait cycle or window: vermilion, the cycles that the finding concerns; gray, all others."
)


def write_check(
    subject: Subject, tables: Sequence[Table], findings: Sequence[Finding], folder: Path, *, force: bool
) -> None:
    """Write ``check.json`` and ``report.html`` into a new folder.

    Parameters
    ----------
    subject
        Subject that was checked.
    tables
        Tables that the command prints.
    findings
        Findings in the recordings.
    folder
        Folder to create.
    force
        Replace an existing folder.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is false, or it cannot be created.
    """
    with new_folder(folder, force=force) as place:
        write_json(place / "check.json", tables_content(tables))
        write_text(place / "report.html", render_check(subject, tables, findings))


def render_check(subject: Subject, tables: Sequence[Table], findings: Sequence[Finding]) -> str:
    """Write the report as a self-contained HTML page."""
    title = f"{subject.name}: check of the recordings"
    under = f"{leg_name(subject.side)}, {subject.mass_kg:g} kg, {counted(len(subject.trials), 'cycle')}."
    gait = subject.trials.only_gait()
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict(findings),
            *(_finding_section(one, subject) for one in findings),
            *([cycles_section(gait)] if len(gait) else []),
            tables_section(tables, "Content of the folder"),
        ],
    )


def _verdict(findings: Sequence[Finding]) -> str:
    if not findings:
        return markup.verdict(
            [
                "Nothing was found that would spoil a calibration.",
                "This does not prove that the recordings are right: look at the cycles below.",
            ],
            fine=True,
        )
    return markup.verdict(
        [
            f"{counted(len(findings), 'finding')} in the recordings.",
            "Each is a question to whoever recorded: what is shown may have another reason.",
        ],
        fine=False,
    )


def _finding_section(finding: Finding, subject: Subject) -> str:
    return markup.section(
        f"{finding.kind.capitalize()}: {', '.join(finding.subjects)}",
        markup.paragraph(f"{finding.sentence[0].upper()}{finding.sentence[1:]}."),
        markup.picture(
            finding_figure(finding, subject),
            alternative=finding.sentence,
            caption=_CAPTIONS.get(finding.kind, _OF_CYCLES),
        ),
    )


@in_style
def finding_figure(finding: Finding, subject: Subject) -> Figure:
    """Draw what a finding is about: a panel for each channel or column that it concerns."""
    recording = next(one for one in subject.recordings if one.name == finding.recording)
    figure, panels = panel_grid(
        len(finding.subjects), min(2, len(finding.subjects)), width=0.6 * PAGE_WIDTH, panel_height=2.2
    )
    if finding.kind == "pelvis residual":
        _draw_residual(panels[0], finding.subjects[0], recording, subject)
    elif finding.kind in ("saturation", "mains"):
        assert recording.emg is not None, "a finding of the EMG of a recording that has none"
        emg = read_storage(recording.emg)
        for panel, channel in zip(panels, finding.subjects, strict=True):
            signal = emg.values[:, find_columns(emg.columns, channel)[0]]
            (_draw_saturation if finding.kind == "saturation" else _draw_spectrum)(panel, emg.time, signal)
    else:
        _draw_cycles(panels, finding, subject)
    for panel, name in zip(panels, finding.subjects, strict=True):
        panel.set_title(name, loc="left", parse_math=False)
    if panels[0].get_legend_handles_labels()[0]:
        legend_above(figure, panels[0])
    return figure


def _draw_cycles(panels: Sequence[Axes], finding: Finding, subject: Subject) -> None:
    """Draw the envelopes of all cycles, those that the finding concerns on top."""
    trials = subject.trials
    emg = trials.emg[..., trials.inside]
    concerned = np.array(
        [
            name in finding.cycles if finding.cycles else recording == finding.recording
            for name, recording in zip(trials.names, trials.recordings, strict=True)
        ]
    )
    gait = all(task == GAIT for task in trials.tasks)
    place = np.linspace(0.0, 100.0 if gait else 1.0, emg.shape[-1])
    for panel, channel in zip(panels, finding.subjects, strict=True):
        row = trials.channels.index(channel)
        draw_zero_line(panel)
        for rows, color, label in ((~concerned, GRAY, "other cycles"), (concerned, VERMILION, "concerned")):
            if rows.any():
                panel.plot(place, emg[rows, row].T, color=color, linewidth=0.8, alpha=0.7)
                panel.lines[-1].set_label(label)
        if not gait:
            panel.set_xlabel("cycle or window")
            panel.set_ylabel("EMG")
    if gait:
        label_gait_cycles(panels, len(panels), y="EMG")


def _draw_saturation(
    panel: Axes, time: Float[np.ndarray, " sample"], signal: Float[np.ndarray, " sample"]
) -> None:
    """Draw the signal around where it first is at its extreme."""
    extreme = float(signal.max()) if signal.max() >= -signal.min() else float(signal.min())
    first = float(time[np.argmax(signal == extreme)])
    shown = np.abs(time - first) <= _AROUND
    panel.plot(time[shown], signal[shown], color=BLUE)
    panel.axhline(extreme, color=VERMILION, linewidth=0.9, linestyle="--")
    panel.set_xlabel("time (s)")
    panel.set_ylabel("EMG, as recorded")


def _draw_spectrum(
    panel: Axes, time: Float[np.ndarray, " sample"], signal: Float[np.ndarray, " sample"]
) -> None:
    rate = sampling_rate(time)
    frequency, power = welch(signal, rate, nperseg=round(2.0 * rate))
    shown = (frequency >= _SPECTRUM[0]) & (frequency <= _SPECTRUM[1])
    panel.semilogy(frequency[shown], np.maximum(power[shown], 1e-30), color=BLUE)
    for mains in (50.0, 60.0):
        panel.axvline(mains, color=VERMILION, linewidth=0.9, linestyle="--")
    panel.set_xlabel("frequency (Hz)")
    panel.set_ylabel("power")


def _draw_residual(panel: Axes, name: str, recording: TrialSettings, subject: Subject) -> None:
    moments: Storage = read_storage(recording.moments)
    column = [component_name(label) for label in moments.columns].index(name)
    force = name.endswith("_force")
    limit = 9.81 * subject.mass_kg * (RESIDUAL_FORCE if force else RESIDUAL_MOMENT)
    panel.axhspan(-limit, limit, color=PALE_BLUE, linewidth=0)
    draw_zero_line(panel)
    for start, end in recording.cycles:
        inside = (moments.time >= start) & (moments.time <= end)
        panel.plot(moments.time[inside], moments.values[inside, column], color=BLACK, linewidth=0.9)
    panel.set_xlabel("time (s)")
    panel.set_ylabel(f"residual ({'N' if force else 'N m'})")
