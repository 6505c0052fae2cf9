"""Report of joint personalisation as a self-contained HTML page, and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.skeleton.bodies import SkeletonStructure, body_poses, build_skeleton
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.joints.freed_parameters import FRAME_KINDS, FreedParameter
from wrapjax.preprocessing.inverse_kinematics import InverseKinematics
from wrapjax.report import markup
from wrapjax.report.formatting import counted
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.style import (
    BLACK,
    BLUE,
    DOT,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    Axes,
    Figure,
    in_style,
    label_rows,
    legend_above,
    new_figure,
)

if TYPE_CHECKING:
    from wrapjax.joints.result import JointPersonalisation, TrialErrors

#: Half the drawn length of a joint's axis, m.
AXIS_LENGTH = 0.06


def render_joints(result: JointPersonalisation, link: str = "") -> str:
    """Write the report of joint personalisation as a self-contained HTML page.

    Parameters
    ----------
    result
        Result.
    link
        Markup of a link to the page of the model in motion; empty if there is none.
    """
    title = f"{result.settings.name}: joints from markers"
    frames = sum(trial.used.size for trial in result.trials)
    under = f"{counted(len(result.trials), 'trial')}, {frames} frames, {len(result.parameters)} freed values."
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict(result),
            link,
            _errors_section(result),
            _skeleton_section(result),
            _changes_section(result),
            _undetermined_section(result),
            _notes_section(result),
        ],
    )


def _verdict(result: JointPersonalisation) -> str:
    rms = {name: 1e3 * value for name, value in result.rms.items() if value is not None}
    falls = rms.get("held_out_after", 0.0) < rms.get("held_out_before", np.inf)
    converged = result.status.converged
    sentences = [
        "The estimation converged."
        if converged
        else f"The estimation did not converge: {result.status.value}",
        f"On the frames used, the model's markers are {rms['after']:.2f} mm from those measured (root mean "
        f"square), before {rms['before']:.2f} mm.",
    ]
    if "held_out_after" in rms:
        verb = "falls" if falls else "does not fall"
        sentences.append(
            f"On frames held out the distance {verb}: {rms['held_out_before']:.2f} mm before, "
            f"{rms['held_out_after']:.2f} mm after."
        )
    known = int(result.posterior.determined.sum())
    sentences.append(
        f"Markers determine {known} of {len(result.parameters)} freed values; the others keep their prior."
    )
    return markup.verdict(sentences, fine=converged and falls)


def _errors_section(result: JointPersonalisation) -> str:
    rows = []
    for trial in result.trials:
        for name, chosen in (("used", trial.used), ("held out", ~trial.used)):
            if chosen.any():
                before, after = (
                    1e3 * float(np.sqrt(np.nanmean(fit.distances[:, chosen] ** 2)))
                    for fit in (trial.before, trial.after)
                )
                rows.append((trial.name, name, f"{int(chosen.sum())}", f"{before:.2f}", f"{after:.2f}"))
    return markup.section(
        "Marker errors",
        markup.table(
            ("trial", "frames", "number", "before", "after"),
            rows,
            caption="Root mean square distance of the model's markers from those measured, mm, after inverse "
            "kinematics with equal weights unless the settings give others.",
        ),
        markup.picture(
            marker_figure(result.trials),
            alternative="Distance of each marker before and after personalisation, by trial.",
            caption="Root mean square distance of each marker over all frames of a trial, before (gray) and "
            "after (blue) personalisation.",
        ),
    )


def _skeleton_section(result: JointPersonalisation) -> str:
    trial = result.trials[0]
    at = trial.before.time[trial.before.time.size // 2]
    return markup.section(
        "Centres and axes",
        markup.picture(
            skeleton_figure(result),
            alternative="Skeleton with joint centres and axes, from two sides.",
            caption=f"Skeleton in {trial.name} at {at:.2f} s, before (gray) and after (blue): lines "
            "from joint to joint, dots at the centres of the personalised joints, and bars along the axes "
            "of hinges. Black: measured markers.",
        ),
    )


def _changes_section(result: JointPersonalisation) -> str:
    scales = [
        (
            owner,
            "all" if parameter.axis < 0 else "xyz"[parameter.axis],
            f"{1.0 + value:.3f}",
            f"{sd:.3f}",
            "yes" if known else "no",
        )
        for owner in result.summary()["scales"]
        for parameter, value, sd, known in result.entries("scale", owner)
    ]
    markers = [
        (
            owner,
            *(f"{1e3 * row[1]:.1f}" for row in result.entries("marker", owner)),
            f"{1e3 * max(row[2] for row in result.entries('marker', owner)):.1f}",
        )
        for owner in result.summary()["markers"]
        if len(result.entries("marker", owner)) == 3
    ]
    parts = [
        markup.picture(
            change_figure(result),
            alternative="Change of each freed value of joint frames with its 90 % interval.",
            caption="Changes of joint frames along and about their axes, with 90 % intervals (blue) on "
            "those of the prior (gray). Values that markers do not determine (hollow) keep their prior.",
        )
    ]
    if scales:
        parts.append(
            markup.table(
                ("body", "axis", "factor", "standard deviation", "determined"),
                scales,
                caption="Scale factors of bodies.",
            )
        )
    if markers:
        table = markup.table(
            ("marker", "x", "y", "z", "largest standard deviation"),
            markers,
            caption="Moves of markers on their bodies, mm, after scaling.",
        )
        parts.append(markup.folded("Markers", table))
    return markup.section("Changes", *parts)


def _undetermined_section(result: JointPersonalisation) -> str:
    rows = [
        (f"{direction.information:.2f}", str(direction)) for direction in result.posterior.directions[:20]
    ]
    if not rows:
        return markup.section(
            "What markers leave open", markup.paragraph("Markers determine all freed values.")
        )
    return markup.section(
        "What markers leave open",
        markup.table(
            ("information", "combination"),
            rows,
            caption="Combinations of freed values, in prior standard deviations, about which the markers say "
            "less than the prior (information below 1), the least known first. Along these the starting "
            "model is kept.",
        ),
    )


def _notes_section(result: JointPersonalisation) -> str:
    noise, skin = 1e3 * result.noise, 1e3 * result.settings.skin_movement
    frames = f"{result.independent_frames:.0f} independent frames"
    return markup.section(
        "Notes",
        markup.bullets(
            [
                f"A marker's coordinate has a noise of {noise:.2f} mm, by residuals that count as {frames}.",
                "Movement of skin with the joint angles is allowed for, and integrated out: prior "
                f"{skin:.0f} mm root mean square.",
                "model_joints.osim holds the personalised model: bodies, muscle points, wrapping surfaces "
                "and lengths scaled by OpenSim with masses kept, then joint frames and markers placed.",
                f"Computed in {result.seconds:.0f} s. {versions_in_words()}.",
            ]
        ),
    )


@in_style
def skeleton_figure(result: JointPersonalisation) -> Figure:
    """Draw the skeleton in one recorded frame, before and after, from the side and from behind."""
    trial = result.trials[0]
    frame = trial.before.time.size // 2
    figure = new_figure(PAGE_WIDTH, 6.0)
    panels = figure.subplots(1, 2)
    freed = {parameter.owner for parameter in result.parameters if parameter.kind in FRAME_KINDS}
    views = (("from the right side", 0), ("from behind", 2))
    measured = trial.before.measured[:, frame]
    for panel, (name, across) in zip(panels, views, strict=True):
        panel.plot(
            measured[:, across], measured[:, 1], ".", color=BLACK, markersize=3, label="marker, measured"
        )
        for description, fit, color, when in (
            (result.before, trial.before, GRAY, "before"),
            (result.after, trial.after, BLUE, "after"),
        ):
            _draw_skeleton(panel, description, fit, frame, freed, across, color, when)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_title(name, loc="left")
        panel.set_xlabel(f"{'xyz'[across]} (m)")
    panels[0].set_ylabel("y (m)")
    legend_above(figure, panels[0])
    return figure


def _draw_skeleton(
    panel: Axes,
    description: ModelDescription,
    fit: InverseKinematics,
    frame: int,
    freed: set[str],
    across: int,
    color: str,
    when: str,
) -> None:
    """Draw lines from joint to joint, and centres and axes of the freed joints."""
    structure, centers, axes = _joint_lines(description, fit, frame)
    for joint, parent in enumerate(structure.parents):
        if parent > 0:
            ends = np.array([centers[parent - 1], centers[joint]])
            panel.plot(ends[:, across], ends[:, 1], color=color, linewidth=0.8, alpha=0.6)
    chosen = [joint for joint, name in enumerate(structure.joints) if name in freed]
    panel.plot(
        centers[chosen, across],
        centers[chosen, 1],
        "o",
        color=color,
        markersize=4,
        label=f"joint centre and axis, {when}",
    )
    for joint in chosen:
        if np.isfinite(axes[joint]).all():
            ends = centers[joint] + AXIS_LENGTH * np.array([[-1.0], [1.0]]) * axes[joint]
            panel.plot(ends[:, across], ends[:, 1], color=color, linewidth=1.6)


def _joint_lines(
    description: ModelDescription, fit: InverseKinematics, frame: int
) -> tuple[SkeletonStructure, Float[np.ndarray, "joint 3"], Float[np.ndarray, "joint 3"]]:
    """Centres of all joints in a frame, m, and the axis of those with one rotation; NaN for others."""
    structure, skeleton = build_skeleton(description, fit.coordinates)
    poses = body_poses(structure, skeleton, fit.values[:, frame][None])
    rotation, origin = poses.rotation[0, 1:], poses.origin[0, 1:]
    centers = origin + np.einsum("jik,jk->ji", rotation, skeleton.child_origin)
    axes = np.full_like(centers, np.nan)
    for joint in range(len(structure.joints)):
        movers = [place for place, (owner, _) in enumerate(structure.movers) if owner == joint]
        spins = [
            poses.angular[0, place] for place in movers if np.linalg.norm(poses.angular[0, place]) > 1e-9
        ]
        if len(spins) == 1:
            axes[joint] = spins[0] / np.linalg.norm(spins[0])
    return structure, centers, axes


@in_style
def marker_figure(trials: Sequence[TrialErrors]) -> Figure:
    """Draw the root mean square distance of each marker before and after, a panel for each trial."""
    names = list(dict.fromkeys(name for trial in trials for name in trial.before.markers))
    figure = new_figure(PAGE_WIDTH, 0.17 * len(names) + 1.3)
    panels = np.atleast_1d(figure.subplots(1, len(trials), sharey=True))
    for panel, trial in zip(panels, trials, strict=True):
        rows = np.array([names.index(name) for name in trial.before.markers])
        both = [1e3 * np.sqrt(np.nanmean(fit.distances**2, axis=1)) for fit in (trial.before, trial.after)]
        panel.hlines(rows, *both, color=LIGHT_GRAY, linewidth=1.5)
        for values, color, when in ((both[0], GRAY, "before"), (both[1], BLUE, "after")):
            panel.plot(values, rows, "o", color=color, label=when, **DOT)
        panel.set_title(trial.name, loc="left", parse_math=False)
        panel.set_xlabel("distance (mm)")
        panel.set_xlim(left=0.0)
    label_rows(panels, names)
    legend_above(figure, panels[0])
    return figure


@in_style
def change_figure(result: JointPersonalisation) -> Figure:
    """Draw the change of each freed value of joint frames with its 90 % interval, and the prior's."""
    groups = [[row for row in _frame_rows(result) if row[0].unit == unit] for unit in ("m", "rad")]
    shown = [(group, unit) for group, unit in zip(groups, ("mm", "deg"), strict=True) if group]
    figure = new_figure(PAGE_WIDTH, 0.17 * max(len(group) for group, _ in shown) + 1.3)
    panels = np.atleast_1d(figure.subplots(1, len(shown)))
    for panel, (group, unit) in zip(panels, shown, strict=True):
        factor = 1e3 if unit == "mm" else np.degrees(1.0)
        rows = np.arange(len(group))
        values, sds, priors = (factor * np.array([row[place] for row in group]) for place in (1, 2, 3))
        panel.axvline(0.0, color=GRAY, linewidth=0.6)
        panel.hlines(rows, -1.645 * priors, 1.645 * priors, color=LIGHT_GRAY, linewidth=4.0, label="prior")
        panel.hlines(rows, values - 1.645 * sds, values + 1.645 * sds, color=BLUE, linewidth=1.2)
        known = np.array([row[4] for row in group], dtype=bool)
        # An empty line that is not clipped has no extent, which breaks the layout.
        for chosen, fill, label in ((known, BLUE, "determined by markers"), (~known, "white", "prior holds")):
            if chosen.any():
                panel.plot(
                    values[chosen], rows[chosen], "o", color=BLUE, markerfacecolor=fill, label=label, **DOT
                )
        panel.set_xlabel(f"change ({unit})")
        label_rows([panel], [row[0].name.replace("_", " ") for row in group])
    legend_above(figure, *panels)
    return figure


def _frame_rows(result: JointPersonalisation) -> list[tuple[FreedParameter, float, float, float, bool]]:
    """Freed values of joint frames: parameter, change, posterior and prior spread, whether determined."""
    rows = zip(
        result.parameters,
        result.values.tolist(),
        result.posterior.sd.tolist(),
        result.posterior.determined.tolist(),
        strict=True,
    )
    return [
        (parameter, value, sd, parameter.sd, known)
        for parameter, value, sd, known in rows
        if parameter.kind in FRAME_KINDS
    ]
