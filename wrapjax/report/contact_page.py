"""Figures of contact forces over the gait cycle.

The report of contact forces: one page that opens anywhere, offline.

The folder of contact forces, written whole or not at all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from wrapjax.comparison.statistics import PairedTest, Spread, spread
from wrapjax.contact_forces.gait_phase import uniform_phases
from wrapjax.contact_forces.result import JOINT_REACTION, ContactResult, RunContact, peak_windows, peaks
from wrapjax.contact_forces.static_optimization import RESIDUAL_SCALE
from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.io.storage import write_storage
from wrapjax.report import markup
from wrapjax.report.contact_summary import (
    compared_peaks,
    describe_contact,
    force_table,
    rms_by_coordinate,
    tests_reason,
    undriven_tables,
)
from wrapjax.report.moment_curves import draw_spread, mark_gait_cycle
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.run_summary import file_stems
from wrapjax.report.style import (
    BLUE,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    counted,
    in_style,
    panel_grid,
    plain,
)

#: Of the first run and of the second.
RUN_COLORS = (BLUE, VERMILION)
_AXES = (("x", "forward"), ("y", "up"), ("z", "to the right"))


@in_style
def magnitude_figure(result: ContactResult) -> Figure:
    """Draw how large the force on each joint and compartment is, one color a run, with all peaks."""
    parts, columns = result.parts, min(3, len(result.parts))
    figure, panels = panel_grid(
        len(parts), columns, width=PAGE_WIDTH, panel_height=2.6, sharex=True, sharey=True
    )
    lowest = 0.0
    for number, (panel, part) in enumerate(zip(panels, parts, strict=True)):
        for run, color in zip(result.runs, RUN_COLORS, strict=False):
            curves = result.curves(run, part) / result.bodyweight
            lowest = min(lowest, float(curves.min()))
            draw_spread(panel, curves, color, run.label)
            for window in peak_windows(part).values():
                found = peaks(curves, result.phase, window)
                place = uniform_phases(curves.shape[1])[found.frame]
                panel.plot(place, found.force, "o", color=color, markersize=3, zorder=3)
        title = f"{part} ({result.joints[part]})" if part in result.joints else part
        panel.set_title(title, loc="left", parse_math=False)
        if number + columns >= len(parts):
            panel.set_xlabel("recorded cycle (%)")
        mark_gait_cycle(panel, step=20)
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
    panels[0].set_ylim(bottom=1.1 * lowest)
    panels[0].set_ylabel("force (bodyweights)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure


@in_style
def component_figure(result: ContactResult) -> Figure:
    """Draw the force on the proximal bone along its axes, one row a joint."""
    joints = list(result.joints)
    figure, panels = panel_grid(
        3 * len(joints), 3, width=PAGE_WIDTH, panel_height=1.6, sharex=True, sharey="row"
    )
    for number, panel in enumerate(panels):
        row, axis = divmod(number, 3)
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        for run, color in zip(result.runs, RUN_COLORS, strict=False):
            draw_spread(panel, run.force[:, row, axis] / result.bodyweight, color, run.label)
        panel.set_title(f"{joints[row]}: {_AXES[axis][0]}, {_AXES[axis][1]}", loc="left", parse_math=False)
        if axis == 0:
            panel.set_ylabel("bodyweights")
        if row == len(joints) - 1:
            panel.set_xlabel("recorded cycle (%)")
        mark_gait_cycle(panel, step=20)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure


_DASH = "\N{EN DASH}"


def render_contact(result: ContactResult) -> str:
    """Write the report of contact forces as one HTML page with nothing outside it."""
    title = f"{result.subject}: {_what(result)}"
    side = {"l": "left", "r": "right"}[result.side]
    under = (
        f"{side.capitalize()} leg, {result.mass_kg:g} kg (one bodyweight is {result.bodyweight:.0f} N), "
        f"{counted(len(result.trials), 'gait cycle')}, by {' and '.join(run.label for run in result.runs)}."
    )
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict(result),
            _forces_section(result),
            _undriven_section(result),
            _notes(result),
        ],
    )


def sentences(result: ContactResult) -> list[str]:
    """Say in plain sentences what the forces are and how large."""
    if result.kind == JOINT_REACTION:
        said = [
            "These are whole contact forces: OpenSim's joint reactions with the calibrated muscle forces, "
            "the recorded motion and the recorded ground forces."
        ]
    else:
        said = [
            "This is the muscles' share alone, not the whole contact force: what muscle forces press joints "
            "together with along their lines of action. Weight, inertia and ground forces are left out, "
            f"because {result.reason}."
        ]
    joint = next(iter(result.joints))
    measure = list(peak_windows(joint))[-1]
    for run in result.runs:
        found = peaks(result.curves(run, joint), result.phase, peak_windows(joint)[measure])
        size, place = spread(found.force / result.bodyweight), spread(found.phase)
        said.append(
            f"{run.label}: the {plain(measure)} at the {joint} is {_with_deviation(size, 2)} bodyweights, at "
            f"{_with_deviation(place, 0)} % of the gait cycle."
        )
    said += [
        f"The calibration {run.label} had not converged, so its forces are not final."
        for run in result.runs
        if not run.converged
    ]
    return said


def _what(result: ContactResult) -> str:
    return (
        "joint contact forces" if result.kind == JOINT_REACTION else "muscles' share of joint contact forces"
    )


def _verdict(result: ContactResult) -> str:
    fine = result.kind == JOINT_REACTION and all(run.converged for run in result.runs)
    return markup.verdict(sentences(result), fine=fine)


def _forces_section(result: ContactResult) -> str:
    tested = list(compared_peaks(result))
    parts = [
        markup.picture(
            magnitude_figure(result),
            alternative="Size of the force in each joint over the gait cycle.",
            caption=f"{_what(result).capitalize()} in bodyweights, mean over cycles and one standard "
            "deviation to either side; dots: the peaks of every cycle.",
        ),
        markup.table(
            ("peak", "run", "bodyweights", "N", "at % of cycle"),
            list(_peak_rows(result)),
            caption="Mean ± standard deviation over cycles. First peak: largest force between 10 and "
            f"30 % of the cycle.{_beginning(result)}",
        ),
    ]
    if reason := tests_reason(result):
        parts.append(markup.paragraph(f"Not tested: {reason}."))
    else:
        parts.append(
            markup.table(
                ("peak", "difference", "95 % interval", "t", "p", "d_z", "cycles"),
                [_test_row(joint, measure, test) for joint, measure, test in tested if test is not None],
                caption=f"{result.runs[1].label} less {result.runs[0].label}, bodyweights: paired t-tests "
                "over gait cycles. Cycles of one person are no sample of persons: read p as a description.",
            )
        )
    parts.append(
        markup.picture(
            component_figure(result),
            alternative="Force on the proximal bone of each joint along three axes.",
            caption="What the distal bone puts on the proximal one, in bodyweights, along the axes of the "
            "proximal bone.",
        )
    )
    return markup.section("Forces", *parts)


def _beginning(result: ContactResult) -> str:
    """Say where in the gait cycle the curves begin, if not at its start."""
    first = result.phase[:, 0]
    if first.max() < 1.0:
        return ""
    place = f"{first.min():.0f}" if np.ptp(first) < 1.0 else f"{first.min():.0f} to {first.max():.0f}"
    return f" It counts from the strike of the foot; the recorded cycles begin {place} % after that."


def _peak_rows(result: ContactResult) -> Iterator[tuple[str, ...]]:
    for part in result.parts:
        for measure, window in peak_windows(part).items():
            for run in result.runs:
                found = peaks(result.curves(run, part), result.phase, window)
                yield (
                    f"{part}, {plain(measure)}",
                    run.label,
                    _with_deviation(spread(found.force / result.bodyweight), 2),
                    _with_deviation(spread(found.force), 0),
                    _with_deviation(spread(found.phase), 0),
                )


def _with_deviation(own: Spread, digits: int) -> str:
    return f"{own.mean:.{digits}f}" + ("" if math.isnan(own.sd) else f" ± {own.sd:.{digits}f}")


def _test_row(joint: str, measure: str, test: PairedTest) -> tuple[str, ...]:
    def shown(value: float, digits: int = 2) -> str:
        return f"{value:.{digits}f}" if math.isfinite(value) else _DASH

    return (
        f"{joint}, {plain(measure)}",
        shown(test.difference, 3),
        f"{test.low:.3f} to {test.high:.3f}" if math.isfinite(test.low) else _DASH,
        shown(test.t),
        "< 0.001" if test.p < 0.001 else shown(test.p, 3),
        shown(test.d_z),
        str(test.n),
    )


def _undriven_section(result: ContactResult) -> str:
    parts = [markup.paragraph(sentence) for sentence in undriven_sentences(result)]
    rows = []
    for coordinate in result.coordinates:
        cells = [coordinate]
        for run in result.runs:
            for moments in (run.undriven.residual_before, run.undriven.residual):
                cells.append(f"{rms_by_coordinate(result, moments)[coordinate]:.2f}")
        rows.append(tuple(cells))
    header = [f"{run.label}, {what}" for run in result.runs for what in ("driven muscles", "all muscles")]
    parts.append(
        markup.table(
            ("coordinate", *header),
            rows,
            caption="Moments that muscles leave unexplained: root mean square over all frames in N m.",
        )
    )
    for run in result.runs:
        if run.undriven.muscles:
            own = run.undriven
            peaked = sorted(zip(own.activation.max(axis=(1, 2)), own.muscles, strict=True), reverse=True)
            strongest = own.force.max(axis=(1, 2))
            parts.append(
                markup.folded(
                    f"Muscles without EMG by {run.label}",
                    markup.table(
                        ("muscle", "peak activation", "peak force (N)"),
                        [
                            (name, f"{size:.2f}", f"{strongest[own.muscles.index(name)]:.0f}")
                            for size, name in peaked
                        ],
                        caption="Largest over all cycles. An activation near 1 says that the muscle is asked "
                        "for more than it can give.",
                    ),
                )
            )
    return markup.section("Muscles without EMG", *parts)


def undriven_sentences(result: ContactResult) -> list[str]:
    """Say what was made of muscles without an electrode, once for runs in which it was the same."""
    said: dict[str, list[str]] = {}
    for run in result.runs:
        said.setdefault(_undriven_sentence(run), []).append(run.label)
    return [f"{' and '.join(labels)}: {sentence}" for sentence, labels in said.items()]


def _undriven_sentence(run: RunContact) -> str:
    own = run.undriven
    if not own.muscles and not own.without_force:
        return "EMG drives every muscle of this leg."
    said = []
    if own.muscles:
        said.append(
            f"{counted(len(own.muscles), 'muscle')} without EMG got the activations whose squares sum to the "
            "least while closing the joint moments that driven muscles leave, frame by frame (static "
            f"optimization; {RESIDUAL_SCALE:g} N m left over weigh as one fully active muscle; strength, "
            "fiber and tendon lengths of the subject's table of muscle parameters, else of its model; active "
            "force alone)."
        )
    if own.without_force:
        said.append(
            f"Without force: {', '.join(own.without_force)}. Contact forces lack what these would press with."
        )
    return " ".join(said)


def _knee_note(result: ContactResult) -> str:
    if result.condyle_distance is None:
        return f"Medial and lateral knee are not told apart: {result.undivided_reason}."
    return (
        f"Medial and lateral knee: two points of contact, {1e3 * result.condyle_distance:.0f} mm apart and "
        "equally far from the joint's center, balance what presses the knee together and turns it in the "
        "frontal plane; ligaments bear nothing. Where a force is below zero, this side would open, and "
        "ligaments have to hold it."
    )


def _notes(result: ContactResult) -> str:
    where = "NGA: muscles run as in the subject's model; PGA: as in the run's model_personalized.osim."
    lines = [
        f"Runs: {', '.join(f'{run.label} in {run.folder}' for run in result.runs)}. {where}",
        _knee_note(result),
        "contact.json holds peaks of every cycle; forces/ the curves in N as OpenSim tables.",
        f"{versions_in_words()}.",
    ]
    if result.kind == JOINT_REACTION:
        lines.insert(
            1,
            "Bodies move as recorded; moments that muscles leave unexplained turn bodies at the coordinates "
            "and press nothing. Muscles pull along OpenSim's own paths.",
        )
    return markup.section("Notes", markup.bullets(lines))


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
