"""Report of joint contact forces as a self-contained HTML page, and the folder that holds it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from wrapjax.comparison.statistics import PairedTest, Spread, spread
from wrapjax.contact_forces.contact_result import (
    JOINT_REACTION,
    ContactResult,
    RunContact,
    peak_windows,
    peaks,
)
from wrapjax.contact_forces.static_optimization import RESIDUAL_SCALE
from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.io.storage import write_storage
from wrapjax.preprocessing.gait.gait_events import uniform_phases
from wrapjax.report import markup
from wrapjax.report.calibration.run_summary import file_stems
from wrapjax.report.contact_forces.summary import (
    compared_peaks,
    describe_contact,
    force_table,
    rms_by_coordinate,
    tests_reason,
    undriven_tables,
)
from wrapjax.report.cycle_panels import draw_spread, label_gait_cycles
from wrapjax.report.formatting import DASH, counted, decimals, leg_name, p_value, readable
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.style import (
    BLUE,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    draw_zero_line,
    in_style,
    legend_above,
    panel_grid,
)

#: Colors of the first and the second run.
RUN_COLORS = (BLUE, VERMILION)
_AXES = (("x", "forward"), ("y", "up"), ("z", "to the right"))


@in_style
def magnitude_figure(result: ContactResult) -> Figure:
    """Draw the magnitude of the force on each joint and compartment, one color a run, with all peaks."""
    parts, columns = result.parts, min(3, len(result.parts))
    figure, panels = panel_grid(
        len(parts), columns, width=PAGE_WIDTH, panel_height=2.6, sharex=True, sharey=True
    )
    lowest = 0.0
    for panel, part in zip(panels, parts, strict=True):
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
        draw_zero_line(panel)
    label_gait_cycles(panels, columns, x="recorded cycle (%)")
    panels[0].set_ylim(bottom=1.1 * lowest)
    panels[0].set_ylabel("force (bodyweights)")
    legend_above(figure, panels[0])
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
        draw_zero_line(panel)
        for run, color in zip(result.runs, RUN_COLORS, strict=False):
            draw_spread(panel, run.force[:, row, axis] / result.bodyweight, color, run.label)
        panel.set_title(f"{joints[row]}: {_AXES[axis][0]}, {_AXES[axis][1]}", loc="left", parse_math=False)
    label_gait_cycles(panels, 3, y="bodyweights", x="recorded cycle (%)")
    legend_above(figure, panels[0])
    return figure


def render_contact(result: ContactResult) -> str:
    """Write the report of contact forces as a self-contained HTML page."""
    title = f"{result.subject}: {_quantity(result)}"
    under = (
        f"{leg_name(result.side)}, {result.mass_kg:g} kg (one bodyweight is {result.bodyweight:.0f} N), "
        f"{counted(len(result.trials), 'gait cycle')}, by {' and '.join(run.label for run in result.runs)}."
    )
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict_section(result),
            _forces_section(result),
            _undriven_section(result),
            _notes_section(result),
        ],
    )


def contact_findings(result: ContactResult) -> list[str]:
    """Write sentences on the kind and the size of the contact forces."""
    if result.kind == JOINT_REACTION:
        findings = [
            "These are total contact forces: OpenSim's joint reactions with the calibrated muscle forces, "
            "the recorded motion and the recorded ground forces."
        ]
    else:
        findings = [
            "This is the contribution of the muscles alone and not the total contact force: the muscle "
            "forces along their lines of action that act across each joint. Weight, inertia and ground "
            f"forces are not included, because {result.reason}."
        ]
    joint = next(iter(result.joints))
    measure = list(peak_windows(joint))[-1]
    for run in result.runs:
        peak = peaks(result.curves(run, joint), result.phase, peak_windows(joint)[measure])
        size, phase = spread(peak.force / result.bodyweight), spread(peak.phase)
        findings.append(
            f"{run.label}: the {readable(measure)} at the {joint} is {_with_deviation(size, 2)} bodyweights, "
            f"at {_with_deviation(phase, 0)} % of the gait cycle."
        )
    findings += [
        f"The calibration {run.label} had not converged, so its forces are not final."
        for run in result.runs
        if not run.converged
    ]
    return findings


def _quantity(result: ContactResult) -> str:
    if result.kind == JOINT_REACTION:
        return "joint contact forces"
    return "muscle contribution to joint contact forces"


def _verdict_section(result: ContactResult) -> str:
    fine = result.kind == JOINT_REACTION and all(run.converged for run in result.runs)
    return markup.verdict(contact_findings(result), fine=fine)


def _forces_section(result: ContactResult) -> str:
    tested = list(compared_peaks(result))
    parts = [
        markup.picture(
            magnitude_figure(result),
            alternative="Magnitude of the force in each joint over the gait cycle.",
            caption=f"{_quantity(result).capitalize()} in bodyweights, mean over cycles ± one standard "
            "deviation; dots: the peaks of every cycle.",
        ),
        markup.table(
            ("peak", "run", "bodyweights", "N", "at % of cycle"),
            list(_peak_rows(result)),
            caption="Mean ± standard deviation over cycles. First peak: largest force between 10 and "
            f"30 % of the cycle.{_start_of_curves(result)}",
        ),
    ]
    if reason := tests_reason(result):
        parts.append(markup.paragraph(f"Not tested: {reason}."))
    else:
        parts.append(
            markup.table(
                ("peak", "difference", "95 % CI", "t", "p", "d_z", "cycles"),
                [_test_row(joint, measure, test) for joint, measure, test in tested if test is not None],
                caption=f"{result.runs[1].label} minus {result.runs[0].label} in bodyweights: paired "
                "t-tests over gait cycles. The cycles are of one person, so p values are descriptive and "
                "cannot be generalized to other people.",
            )
        )
    parts.append(
        markup.picture(
            component_figure(result),
            alternative="Force on the proximal bone of each joint along three axes.",
            caption="Force of the distal on the proximal bone in bodyweights, along the axes of the "
            "proximal bone.",
        )
    )
    return markup.section("Forces", *parts)


def _start_of_curves(result: ContactResult) -> str:
    """Write where in the gait cycle the curves start, if not at foot strike."""
    first = result.phase[:, 0]
    if first.max() < 1.0:
        return ""
    start = f"{first.min():.0f}" if np.ptp(first) < 1.0 else f"{first.min():.0f} to {first.max():.0f}"
    return f" The gait cycle starts at foot strike; the recorded cycles start {start} % later."


def _peak_rows(result: ContactResult) -> Iterator[tuple[str, ...]]:
    for part in result.parts:
        for measure, window in peak_windows(part).items():
            for run in result.runs:
                peak = peaks(result.curves(run, part), result.phase, window)
                yield (
                    f"{part}, {readable(measure)}",
                    run.label,
                    _with_deviation(spread(peak.force / result.bodyweight), 2),
                    _with_deviation(spread(peak.force), 0),
                    _with_deviation(spread(peak.phase), 0),
                )


def _with_deviation(values: Spread, places: int) -> str:
    return f"{values.mean:.{places}f}" + ("" if math.isnan(values.sd) else f" ± {values.sd:.{places}f}")


def _test_row(joint: str, measure: str, test: PairedTest) -> tuple[str, ...]:
    return (
        f"{joint}, {readable(measure)}",
        decimals(test.difference, 3),
        f"{test.low:.3f} to {test.high:.3f}" if math.isfinite(test.low) else DASH,
        decimals(test.t),
        p_value(test.p),
        decimals(test.d_z),
        str(test.n),
    )


def _undriven_section(result: ContactResult) -> str:
    parts = [markup.paragraph(sentence) for sentence in undriven_findings(result)]
    rows = []
    for coordinate in result.coordinates:
        cells = [coordinate]
        for run in result.runs:
            for moments in (run.undriven.residual_before, run.undriven.residual):
                cells.append(f"{rms_by_coordinate(result, moments)[coordinate]:.2f}")
        rows.append(tuple(cells))
    header = [f"{run.label}, {which}" for run in result.runs for which in ("driven muscles", "all muscles")]
    parts.append(
        markup.table(
            ("coordinate", *header),
            rows,
            caption="Moments that muscles leave unexplained: root mean square over all frames in N m.",
        )
    )
    for run in result.runs:
        if run.undriven.muscles:
            undriven = run.undriven
            largest = undriven.activation.max(axis=(1, 2))
            order = sorted(zip(largest, undriven.muscles, strict=True), reverse=True)
            forces = undriven.force.max(axis=(1, 2))
            parts.append(
                markup.folded(
                    f"Muscles without EMG by {run.label}",
                    markup.table(
                        ("muscle", "peak activation", "peak force (N)"),
                        [
                            (name, f"{size:.2f}", f"{forces[undriven.muscles.index(name)]:.0f}")
                            for size, name in order
                        ],
                        caption="Largest values over all cycles. An activation near 1 means that the "
                        "required force approaches or exceeds what the muscle can exert.",
                    ),
                )
            )
    return markup.section("Muscles without EMG", *parts)


def undriven_findings(result: ContactResult) -> list[str]:
    """Write how muscles without an electrode were treated, once for runs with the same treatment."""
    labels_by_sentence: dict[str, list[str]] = {}
    for run in result.runs:
        labels_by_sentence.setdefault(_undriven_finding(run), []).append(run.label)
    return [f"{' and '.join(labels)}: {sentence}" for sentence, labels in labels_by_sentence.items()]


def _undriven_finding(run: RunContact) -> str:
    undriven = run.undriven
    if not undriven.muscles and not undriven.without_force:
        return "EMG drives every muscle of this leg."
    findings = []
    if undriven.muscles:
        findings.append(
            f"The activations of {counted(len(undriven.muscles), 'muscle')} without EMG were computed by "
            "static optimization: frame by frame, they minimize the sum of squared activations while "
            f"balancing the joint moments that the driven muscles leave unexplained ({RESIDUAL_SCALE:g} N m "
            "of unexplained moment count as much as one fully active muscle). Strength, fiber and tendon "
            "lengths are those of the subject's table of muscle parameters, otherwise those of its model; "
            "passive force is not included."
        )
    if undriven.without_force:
        findings.append(
            f"Without force: {', '.join(undriven.without_force)}. Their contribution is missing from the "
            "contact forces."
        )
    return " ".join(findings)


def _knee_note(result: ContactResult) -> str:
    if result.condyle_distance is None:
        return f"Medial and lateral knee forces were not computed: {result.undivided_reason}."
    return (
        f"Medial and lateral knee forces: two contact points, {1e3 * result.condyle_distance:.0f} mm apart "
        "and equally far from the joint center, balance the compressive force and the frontal-plane moment "
        "of the knee; ligament forces are assumed to be zero. A force below zero means that this compartment "
        "would open unless ligaments resist."
    )


def _notes_section(result: ContactResult) -> str:
    paths = "NGA: muscle paths of the subject's model; PGA: those of the run's model_personalized.osim."
    lines = [
        f"Runs: {', '.join(f'{run.label} in {run.folder}' for run in result.runs)}. {paths}",
        _knee_note(result),
        "contact.json contains the peaks of every cycle; forces/ the curves in N as OpenSim tables.",
        f"{versions_in_words()}.",
    ]
    if result.kind == JOINT_REACTION:
        lines.insert(
            1,
            "The motion is the recorded motion; moments that muscles leave unexplained act at the "
            "coordinates as pure moments without a contact force. Muscle forces act along OpenSim's muscle "
            "paths.",
        )
    return markup.section("Notes", markup.bullets(lines))


def write_contact(result: ContactResult, folder: Path, *, force: bool = False) -> None:
    """Write ``contact.json``, the curves of every run and cycle, and ``report.html``.

    Parameters
    ----------
    result
        Contact forces of one or two runs.
    folder
        Folder to write; it appears when it is complete.
    force
        Whether to replace an existing folder.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set, or cannot be created.
    """
    with new_folder(folder, force=force) as target:
        write_json(target / "contact.json", describe_contact(result))
        labels = file_stems(tuple(run.label for run in result.runs))
        for run in result.runs:
            for trial, stem in enumerate(file_stems(result.trials).values()):
                name = f"{stem}.sto"
                write_storage(target / "forces" / labels[run.label] / name, force_table(result, run, trial))
                for kind, table in undriven_tables(result, run, trial).items():
                    write_storage(target / kind / labels[run.label] / name, table)
        write_text(target / "report.html", render_contact(result))
