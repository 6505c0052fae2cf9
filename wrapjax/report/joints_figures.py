"""Figures of joint personalisation: skeleton, marker errors, and changes with their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.model_description import ModelDescription
from wrapjax.geometry.skeleton import SkeletonStructure, body_poses, build_skeleton
from wrapjax.joints.freed_parameters import FRAME_KINDS, FreedParameter
from wrapjax.preprocessing.inverse_kinematics import InverseKinematics
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
