"""The two ways of wrapping side by side: what OpenSim does with a path, and the shortest path.

Only of the shortest path are moment arms the derivatives of lengths. OpenSim's own agree with its lengths
as far as its path round a cylinder is the shortest, and no further.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.engine import (
    GEODESIC,
    PARITY,
    ExactPaths,
    Wrapping,
    nominal_parameters,
    wrap_at_samples,
)
from wrapjax.report.moment_curves import mark_gait_cycle
from wrapjax.report.style import (
    BLUE,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Axes,
    Figure,
    in_style,
    new_figure,
)

if TYPE_CHECKING:
    from wrapjax.geometry.model_description import ModelDescription

#: Step of differences (rad or m): of their error, that of rounding and that of curvature are alike.
STEP = 1e-4
_ROW_HEIGHT = 1.9
_LEAST_RANGE_MM = 0.01


@dataclass(frozen=True)
class LaidPath:
    """A path as one way of wrapping lays it, over a movement.

    Parameters
    ----------
    length
        m.
    moment_arm
        As the way of wrapping gives it, m/rad.
    slope
        -dL/dq of the same length by central differences, m/rad.
    """

    length: Float[np.ndarray, " frame"]
    moment_arm: Float[np.ndarray, "coordinate frame"]
    slope: Float[np.ndarray, "coordinate frame"]

    @property
    def disagreement(self) -> float:
        """How far moment arm and -dL/dq are apart at most, m/rad."""
        return float(np.abs(self.moment_arm - self.slope).max())


@dataclass(frozen=True)
class WrappingModes:
    """One muscle's path over a movement by either way of wrapping, about the coordinates it spans."""

    muscle: str
    coordinates: tuple[str, ...]
    opensim: LaidPath
    shortest: LaidPath


def compare_wrapping_modes(
    model: ModelDescription,
    muscle: str,
    coordinates: Sequence[str],
    poses: Float[np.ndarray, "frame coordinate"],
    parameters: Float[np.ndarray, "wrap wrap_parameter"] | None = None,
) -> WrappingModes:
    """Lay a muscle's path both ways in every frame of a movement.

    Parameters
    ----------
    model
        From `wrapjax.osim.describe_model`.
    muscle
        Whose path.
    coordinates, poses
        Their values, rad or m. Of them the result has those that the muscle spans.
    parameters
        Of the muscle's cylinders in the order of its path, as in `WRAP_PARAMETERS`; nominal if not given.

    Raises
    ------
    InputError
        If the path has something that the exact engine does not know.
    """
    engine = ExactPaths(model, (muscle,), coordinates)
    spanned = [own for own in coordinates if own in model.spanned_by(muscle)]
    columns = [engine.coordinates.index(own) for own in spanned]
    # Every frame as it is, and a step to either side along each coordinate.
    steps = STEP * np.eye(len(engine.coordinates))[columns]
    shifts = np.concatenate([np.zeros((1, steps.shape[1])), steps, -steps])
    posed = engine.posed((poses[None] + shifts[:, None]).reshape(-1, poses.shape[1]))[muscle]
    placed = nominal_parameters(len(engine.wraps_of(muscle))) if parameters is None else parameters

    def laid(wrapping: Wrapping) -> LaidPath:
        found = wrap_at_samples(posed, placed[None], wrapping)
        length = np.asarray(found.length[0]).reshape(len(shifts), len(poses))
        ahead, behind = np.split(length[1:], 2)
        return LaidPath(
            length=length[0],
            moment_arm=np.asarray(found.moment_arm[0, : len(poses)])[:, columns].T,
            slope=(behind - ahead) / (2.0 * STEP),
        )

    return WrappingModes(muscle, tuple(spanned), laid(PARITY), laid(GEODESIC))


@in_style
def wrapping_modes_figure(compared: Sequence[WrappingModes]) -> Figure:
    """Draw length and moment arms over the gait cycle, and under each how the ways of wrapping differ.

    One pair of rows a muscle; the lower one names the largest difference of what OpenSim gives, of moment
    arms the arm's and that of its length's slope. Frames are taken to go evenly from 0 to 100 % of a cycle.
    """
    columns = 1 + max(len(one.coordinates) for one in compared)
    figure = new_figure(PAGE_WIDTH, 2 * _ROW_HEIGHT * len(compared) + 0.5)
    panels = figure.subplots(2 * len(compared), columns, squeeze=False, sharex=True)
    for one, (above, below) in zip(compared, panels.reshape(-1, 2, columns), strict=True):
        _draw_length(above[0], below[0], one)
        for row, name in enumerate(one.coordinates):
            _draw_arm(above[row + 1], below[row + 1], one, row, name)
        for spare in (*above[len(one.coordinates) + 1 :], *below[len(one.coordinates) + 1 :]):
            spare.remove()
        above[0].set_ylabel("mm")
        below[0].set_ylabel("mm, less the shortest path's")
    for panel in panels[-1]:
        if panel.figure is not None:
            panel.set_xlabel("gait cycle (%)")
    mark_gait_cycle(panels[0, 0], step=20)
    figure.legend(*panels[1, 1].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return figure


def _draw_length(above: Axes, below: Axes, one: WrappingModes) -> None:
    longer = one.opensim.length - one.shortest.length
    above.set_title(f"{one.muscle}: length", loc="left", parse_math=False)
    _draw_curve(above, one.opensim.length, VERMILION, linewidth=2.4, alpha=0.5)
    _draw_curve(above, one.shortest.length, BLUE)
    below.set_title(f"largest: {_mm(longer)} mm", loc="left")
    _draw_curve(below, longer, VERMILION, linewidth=2.4, alpha=0.5)
    _finish(below)


def _draw_arm(above: Axes, below: Axes, one: WrappingModes, row: int, name: str) -> None:
    reference = one.shortest.moment_arm[row]
    above.set_title(f"moment arm, {name}", loc="left", parse_math=False)
    for panel, origin in ((above, 0.0), (below, reference)):
        arms = (one.opensim.moment_arm[row] - origin, one.shortest.moment_arm[row] - origin)
        slopes = (one.opensim.slope[row] - origin, one.shortest.slope[row] - origin)
        _draw_curve(panel, arms[0], VERMILION, linewidth=2.4, alpha=0.5, label="OpenSim's moment arm")
        _draw_curve(panel, slopes[0], VERMILION, linestyle=":", label="-dL/dq of OpenSim's length")
        _draw_curve(panel, arms[1], BLUE, label="the shortest path's moment arm")
        _draw_curve(panel, slopes[1], GRAY, linestyle=(0, (2, 4)), label="-dL/dq of the shortest length")
    arm, slope = (_mm(values[row] - reference) for values in (one.opensim.moment_arm, one.opensim.slope))
    below.set_title(f"largest: {arm} and {slope} mm", loc="left")
    _finish(below)


def _draw_curve(panel: Axes, values: Float[np.ndarray, " frame"], color: str, **style: object) -> None:
    panel.plot(np.linspace(0.0, 100.0, values.size), 1e3 * values, color=color, **style)


def _finish(below: Axes) -> None:
    """Mark zero, and do not blow rounding up to the height of a panel."""
    below.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
    low, high = below.get_ylim()
    missing = max(0.0, _LEAST_RANGE_MM - (high - low))
    below.set_ylim(low - 0.5 * missing, high + 0.5 * missing)


def _mm(values: Float[np.ndarray, " frame"]) -> str:
    largest = 1e3 * float(np.abs(values).max())
    return f"{largest:.2g}" if largest >= 1e-3 else "< 0.001"
