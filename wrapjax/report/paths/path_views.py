"""Report section on changed muscle paths: moment arms, and paths with their wrapping surfaces in space.

Paths in space are shown in parallel projection, so distances perpendicular to the line of sight are to scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.geometry.exact_paths.routed_path import PlacedWrap, RoutedPath
from wrapjax.geometry.surfaces.wrap_methods import CYLINDER
from wrapjax.report import markup
from wrapjax.report.cycle_panels import draw_spread, label_gait_cycles
from wrapjax.report.formatting import counted
from wrapjax.report.model_view.wrap_shapes import local_mesh
from wrapjax.report.paths.moved_paths import MovedPath, describe_move
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    PAGE_WIDTH,
    Axes,
    Figure,
    draw_zero_line,
    in_style,
    legend_above,
    new_figure,
    panel_grid,
)

_FACETS = 36
_PANEL = PAGE_WIDTH / 4
_TITLE = 0.75
# Views, with the angle from the surface's axis to the line of sight (rad).
_VIEWS = (("along the axis", 0.0), ("from the side", np.deg2rad(68.0)))
# OpenSim's ground frame: x points to the front, y up, z to the right.
_DIRECTIONS = (("up", (0.0, 1.0, 0.0)), ("front", (1.0, 0.0, 0.0)), ("right", (0.0, 0.0, 1.0)))


@dataclass(frozen=True)
class Camera:
    """Parallel projection about a target point.

    Parameters
    ----------
    axes
        Unit vectors to the right, up and towards the viewer, in the ground frame.
    target
        Center of the picture in the ground frame, m.
    """

    axes: Float[np.ndarray, "3 3"]
    target: Float[np.ndarray, " 3"]

    def project(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Convert points in the ground frame (m) to mm to the right, up and towards the viewer."""
        return 1e3 * (points - self.target) @ self.axes.T


def path_views(moves: Sequence[MovedPath], *, of: str = "") -> str:
    """Write the picture of moved paths with its caption; empty if there are none.

    Parameters
    ----------
    moves
        Paths to draw.
    of
        Leg and method for the caption, where a page shows several.
    """
    if not moves:
        return ""
    changes = "; ".join(
        f"{move.muscle} round {', '.join(describe_move(*pair) for pair in move.touched)}" for move in moves
    )
    owner = f" of {of}" if of else ""
    return markup.picture(
        path_view_figure(moves),
        alternative=f"Paths and surfaces{owner} in space before and after calibration: {changes}.",
        caption=f"Muscles{owner} whose moment arms changed most as their surfaces moved: path and surface "
        "before (gray) and after calibration (blue), each seen along the surface's axis z and from the side, "
        "in the recorded frame where the moment arm changed most. Dots: the model's path points (black), and "
        "the points where the path meets and leaves the surface (white). Only the region near the surface is "
        "shown; cylinders are cut off far from the path, and a thick edge is an actual end of the cylinder. "
        "Scales differ.",
    )


@in_style
def path_view_figure(moves: Sequence[MovedPath]) -> Figure:
    """Draw each moved path in two views, two muscles in a row."""
    rows = -(-len(moves) // 2)
    columns = 2 * min(2, len(moves))
    figure = new_figure(_PANEL * columns, rows * (_PANEL + _TITLE))
    figure.get_layout_engine().set(wspace=0.01, hspace=0.04)
    parts = figure.subfigures(rows, columns // 2, squeeze=False).ravel()
    for part, move in zip(parts, moves, strict=False):
        lines = [
            f"{move.muscle}, {move.place}: moment arm about {move.coordinate} "
            f"{1e3 * move.arm_before:.1f} to {1e3 * move.arm_after:.1f} mm",
            *(describe_move(*pair) for pair in move.touched),
        ]
        part.suptitle("\n".join(lines), x=0.02, ha="left", fontsize=8.0, parse_math=False)
        for panel, (view, tilt) in zip(part.subplots(1, 2), _VIEWS, strict=True):
            _draw_view(panel, move, tilt)
            panel.text(
                *(0.98, 0.02, view),
                transform=panel.transAxes,
                ha="right",
                fontsize=7.0,
                color="#555555",
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
                zorder=6,
            )
    return figure


def look_at(move: MovedPath, tilt: float) -> Camera:
    """Place a camera ``tilt`` (rad) off the axis of the cylinder that moved most, on the muscle's side."""
    before, after = max(move.touched, key=_most_moved)
    target = np.concatenate([_near(before, move.before), _near(after, move.after)]).mean(axis=0)
    axis = before.axes[:, 2]
    # From the axis of the cylinder to the muscle.
    outward = target - before.center
    outward = outward - (outward @ axis) * axis
    distance = np.linalg.norm(outward)
    # A path through the axis lies on neither side, so any side can be used.
    outward = outward / distance if distance > 1e-6 else before.axes[:, 0]
    toward = np.cos(tilt) * axis + np.sin(tilt) * outward
    # The vertical is upward in the picture, unless the line of sight is nearly vertical.
    up = np.array([0.0, 1.0, 0.0]) if abs(toward[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = np.cross(up, toward)
    right = right / np.linalg.norm(right)
    middle = target if tilt else 0.5 * (target + before.center + axis * ((target - before.center) @ axis))
    return Camera(np.stack([right, np.cross(toward, right), toward]), middle)


def _near(cylinder: PlacedWrap, route: RoutedPath) -> Float[np.ndarray, "vertex 3"]:
    """Select the vertices of a path that lie on the cylinder, or the nearest one if none does."""
    if cylinder.kind != CYLINDER:
        if cylinder.name in route.contacts:
            return route.contacts[cylinder.name]
        nearest = np.linalg.norm(route.line - cylinder.center, axis=1).argmin()
        return route.line[nearest : nearest + 1]
    distance = np.linalg.norm(cylinder.to_surface_frame(route.line)[:, :2], axis=1)
    on_surface = distance < cylinder.radius + 1e-6
    return route.line[on_surface if on_surface.any() else [int(distance.argmin())]]


def _most_moved(pair: tuple[PlacedWrap, PlacedWrap]) -> float:
    """Estimate how far the surface of a cylinder moved, m."""
    before, after = pair
    turn = np.linalg.norm(before.axes[:, 2] - after.axes[:, 2])
    shift = np.linalg.norm(after.center - before.center)
    reach = before.half_length if before.kind == CYLINDER else max(before.sizes)
    return float(shift + turn * reach + abs(after.radius - before.radius))


def _draw_view(panel: Axes, move: MovedPath, tilt: float) -> None:
    camera = look_at(move, tilt)
    extent = 0.0
    for place, color in enumerate((GRAY, BLUE)):
        for pair in move.touched:
            if pair[place].kind == CYLINDER:
                shown = _shown_heights(pair[place], move)
                extent = max(extent, _draw_cylinder(panel, camera, pair[place], *shown, color))
            else:
                extent = max(extent, _draw_surface(panel, camera, pair[place], color))
    _draw_path(panel, camera, move.before, GRAY)
    _draw_path(panel, camera, move.after, BLUE)
    extent = 1.12 * max(extent, *(np.abs(camera.project(ends)[:, :2]).max() for ends in _all_contacts(move)))
    panel.set_xlim(-extent, extent)
    panel.set_ylim(-extent, extent)
    panel.set_aspect("equal")
    panel.set_axis_off()
    _draw_scale(panel, extent)
    _draw_directions(panel, camera)


def _all_contacts(move: MovedPath) -> list[Float[np.ndarray, "2 3"]]:
    """Collect the points where paths meet and leave cylinders; centers of the cylinders if there are none."""
    contacts = [ends for route in (move.before, move.after) for ends in route.contacts.values()]
    return contacts or [np.zeros((2, 3)) + pair[0].center for pair in move.touched]


def _shown_heights(cylinder: PlacedWrap, move: MovedPath) -> tuple[float, float]:
    """Choose the part of a cylinder's axis to draw (m along the axis): that near the contacts."""
    heights = cylinder.to_surface_frame(np.concatenate(_all_contacts(move)))[:, 2]
    margin = 0.9 * cylinder.radius
    low = np.clip(heights.min() - margin, -cylinder.half_length, cylinder.half_length)
    high = np.clip(heights.max() + margin, -cylinder.half_length, cylinder.half_length)
    return (float(low), float(high)) if low < high else (-cylinder.half_length, cylinder.half_length)


def _draw_cylinder(
    panel: Axes, camera: Camera, cylinder: PlacedWrap, low: float, high: float, color: str
) -> float:
    """Draw a translucent surface, its axis and both edges; return its extent from the center (mm)."""
    angles = np.linspace(0.0, 2.0 * np.pi, _FACETS + 1)
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    rings = [
        camera.project(cylinder.to_ground_frame(cylinder.radius * circle + [0.0, 0.0, height]))
        for height in (low, high)
    ]
    both = np.concatenate(rings)[:, :2]
    panel.fill(*both[ConvexHull(both).vertices].T, color=color, alpha=0.2, linewidth=0)
    # Lines along the near side show the curvature.
    near = (circle @ cylinder.axes.T @ camera.axes.T)[:, 2] > 0.0
    for place in np.flatnonzero(near[:-1])[::2]:
        ends = np.stack([ring[place, :2] for ring in rings])
        panel.plot(*ends.T, color=color, linewidth=0.5, alpha=0.35)
    for ring, height in zip(rings, (low, high), strict=True):
        is_end = abs(abs(height) - cylinder.half_length) < 1e-9
        panel.plot(
            *ring[:, :2].T, color=color, linewidth=1.6 if is_end else 0.6, alpha=0.9 if is_end else 0.5
        )
    axis = camera.project(cylinder.to_ground_frame(np.array([[0.0, 0.0, low], [0.0, 0.0, high]])))
    panel.plot(*axis[:, :2].T, color=color, linewidth=0.7, linestyle=(0, (6, 3)))
    panel.plot(*axis[-1:, :2].T, "+", color=color, markersize=6.0)
    return float(np.abs(np.concatenate(rings)[:, :2]).max())


def _draw_surface(panel: Axes, camera: Camera, surface: PlacedWrap, color: str) -> float:
    """Draw lines on the near side of another surface; return its extent from the picture's center (mm)."""
    vertices, _, lines = local_mesh(surface.kind, surface.sizes)
    seen = camera.project(surface.to_ground_frame(vertices))
    if surface.kind != "torus":
        outline = seen[ConvexHull(seen[:, :2]).vertices, :2]
        panel.fill(*outline.T, color=color, alpha=0.2, linewidth=0)
    middle = camera.project(surface.center[None])[0]
    near = seen[lines][:, :, 2].mean(axis=1) > middle[2]
    for ends in seen[lines[near]]:
        panel.plot(*ends[:, :2].T, color=color, linewidth=0.5, alpha=0.35)
    panel.plot(*middle[:2], "+", color=color, markersize=6.0)
    return float(np.abs(seen[:, :2]).max())


def _draw_path(panel: Axes, camera: Camera, route: RoutedPath, color: str) -> None:
    panel.plot(
        *camera.project(route.line)[:, :2].T, color=color, linewidth=2.0, solid_capstyle="round", zorder=3
    )
    panel.plot(*camera.project(route.points)[:, :2].T, "o", color=BLACK, markersize=3.5, zorder=5)
    for ends in route.contacts.values():
        places = camera.project(ends)[:, :2].T
        panel.plot(*places, "o", markerfacecolor="white", markeredgecolor=color, markersize=4.0, zorder=4)


def _draw_scale(panel: Axes, extent: float) -> None:
    length = max(step for step in (2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if step < 0.6 * extent or step == 2.0)
    left, height = 0.96 * extent - length, 0.95 * extent
    panel.plot([left, left + length], [height, height], color=BLACK, linewidth=1.4, solid_capstyle="butt")
    place = (left + 0.5 * length, height - 0.03 * extent)
    panel.text(*place, f"{length:g} mm", ha="center", va="top", fontsize=7.0)


def _draw_directions(panel: Axes, camera: Camera) -> None:
    """Draw arrows for up, front and right, unless they are nearly along the line of sight."""
    middle, size = np.array([0.13, 0.13]), 0.09
    drawn: list[Float[np.ndarray, " 2"]] = []
    for name, direction in _DIRECTIONS:
        across = camera.axes[:2] @ np.array(direction)
        length = np.linalg.norm(across)
        # Arrows that overlap could not be read.
        if length < 0.5 or any(across @ other > 0.9 * length for other in drawn):
            continue
        drawn.append(across / length)
        tip = middle + size * across
        panel.annotate(
            "",
            tip,
            middle,
            xycoords="axes fraction",
            textcoords="axes fraction",
            arrowprops={"arrowstyle": "->", "color": "#555555", "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0},
        )
        place = middle + size * across + 0.045 * across / length
        panel.text(
            *place, name, transform=panel.transAxes, ha="center", va="center", fontsize=6.5, color="#555555"
        )


#: Number of moment arms that are drawn, those that changed most.
MOST_PANELS = 12

Arms = Float[np.ndarray, "muscle trial coordinate frame"]


def path_section(result: CalibrationResult, moves: Sequence[MovedPath] = ()) -> str:
    """Write the report section on muscle paths; empty if paths were held fixed.

    Parameters
    ----------
    result
        Result of the calibration.
    moves
        Paths to show in space, from `moved_paths`.
    """
    moving = result.freedom.moving_paths
    if moving is None:
        return ""
    free = np.flatnonzero(moving)
    if not largest_changes(result):
        return markup.section(
            "Muscle paths",
            markup.paragraph(f"The paths of {counted(len(free), 'muscle')} were free, but none changed."),
        )
    length, arm, spanned = _changes(result)
    muscle, coordinate = largest_changes(result)[0]
    order = free[np.argsort(-length[free].mean(axis=(1, 2)))]
    return markup.section(
        "Muscle paths",
        markup.paragraph(
            f"The paths of {len(free)} of {counted(len(result.muscles), 'muscle')} were free to change. "
            f"Their lengths changed by {length[free].mean():.1f} mm on average, their moment arms by "
            f"{arm[free].mean(axis=(1, 3))[spanned[free]].mean():.1f} mm. {_source_of_changes(result)}"
        ),
        markup.picture(
            moment_arm_figure(result),
            alternative="Moment arms over the gait cycle before and after calibration; that of "
            f"{result.muscles[muscle]} about {result.coordinates[coordinate]} changed most.",
            caption="Moment arms in mm over the gait cycle, all cycles: nominal (gray) and calibrated "
            "(blue), mean ± one standard deviation. Shown are those that changed most on average, largest "
            "change first. Scales differ.",
        ),
        path_views(moves),
        markup.table(
            ("muscle", "length: mean", "length: largest", "arms: mean", "arms: largest", "largest about"),
            [_change_row(result, muscle) for muscle in order.tolist()],
            caption="Absolute changes in mm over all frames of all cycles, for length and for moment arms "
            "about the coordinates that the muscle spans.",
        ),
    )


def _source_of_changes(result: CalibrationResult) -> str:
    if result.freedom.wraps is not None:
        return (
            "They result from the cylinders that the muscles wrap round, each of which may be translated, "
            "rotated and scaled within its bounds (kind 'wrap' in parameters.csv)."
        )
    return (
        "These paths are polynomials without anatomical constraints: neither bones nor surfaces restrict "
        "them, only penalties on the change and the hard limits (see Solver)."
    )


def _change_row(result: CalibrationResult, muscle: int) -> tuple[str, ...]:
    length, arm, spanned = (change[muscle] for change in _changes(result))
    return (
        result.muscles[muscle],
        f"{length.mean():.1f}",
        f"{length.max():.1f}",
        f"{arm[:, spanned].mean():.1f}",
        f"{arm.max():.1f}",
        result.coordinates[int(arm.max(axis=(0, 2)).argmax())],
    )


@in_style
def moment_arm_figure(result: CalibrationResult) -> Figure:
    """Draw the moment arms that changed most, nominal and calibrated."""
    before, after = _arms(result)
    pairs = largest_changes(result)
    figure, panels = panel_grid(len(pairs), 4, width=PAGE_WIDTH, panel_height=1.6, sharex=True)
    for panel, (muscle, coordinate) in zip(panels, pairs, strict=True):
        draw_zero_line(panel)
        draw_spread(panel, 1e3 * before[muscle, :, coordinate], GRAY, "nominal")
        draw_spread(panel, 1e3 * after[muscle, :, coordinate], BLUE, "calibrated")
        title = f"{result.muscles[muscle]}\n{result.coordinates[coordinate]}"
        panel.set_title(title, loc="left", parse_math=False)
    label_gait_cycles(panels, 4, y="moment arm (mm)", step=50)
    legend_above(figure, panels[0])
    return figure


def largest_changes(result: CalibrationResult) -> list[tuple[int, int]]:
    """List muscle and coordinate indices of the moment arms with the largest mean changes, in this order."""
    mean = _changes(result)[1].mean(axis=(1, 3))
    order = np.argsort(-mean, axis=None)[:MOST_PANELS]
    places = [divmod(int(place), mean.shape[1]) for place in order]
    return [place for place in places if mean[place] > 0.0]


def _arms(result: CalibrationResult) -> tuple[Arms, Arms]:
    return np.asarray(result.initial_states.path.moment_arm), np.asarray(result.states.path.moment_arm)


def _changes(
    result: CalibrationResult,
) -> tuple[Float[np.ndarray, "muscle trial frame"], Arms, Bool[np.ndarray, "muscle coordinate"]]:
    """Compute absolute changes of lengths and moment arms in mm, and which coordinates each muscle spans."""
    before, after = _arms(result)
    length = np.asarray(result.states.path.length - result.initial_states.path.length)
    return 1e3 * np.abs(length), 1e3 * np.abs(after - before), (before != 0.0).any(axis=(1, 3))
