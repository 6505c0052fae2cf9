"""Report of joint personalisation as a self-contained HTML page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrapjax.report import markup
from wrapjax.report.formatting import counted
from wrapjax.report.joints_figures import change_figure, marker_figure, skeleton_figure
from wrapjax.report.provenance import versions_in_words

if TYPE_CHECKING:
    from wrapjax.joints.result import JointPersonalisation


def render_joints(result: JointPersonalisation) -> str:
    """Write the report of joint personalisation as a self-contained HTML page."""
    title = f"{result.settings.name}: joints from markers"
    frames = sum(trial.used.size for trial in result.trials)
    under = f"{counted(len(result.trials), 'trial')}, {frames} frames, {len(result.parameters)} freed values."
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict(result),
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
