"""Comparison of the two wrapping modes: OpenSim's path (parity) and the shortest path (geodesic).

Moment arms equal the derivatives -dL/dq of the path length only for the shortest path. OpenSim's moment arms
agree with its lengths to the extent that its path round a cylinder is the shortest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.exact_paths.engine import (
    GEODESIC,
    PARITY,
    ExactPaths,
    Wrapping,
    nominal_parameters,
    wrap_at_samples,
)
from wrapjax.report.cycle_panels import mark_gait_cycle
from wrapjax.report.style import (
    BLUE,
    GRAY,
    PAGE_WIDTH,
    VERMILION,
    Axes,
    Figure,
    draw_zero_line,
    in_style,
    legend_above,
    new_figure,
)

if TYPE_CHECKING:
    from wrapjax.geometry.skeleton.model_description import ModelDescription

#: Step of central differences (rad or m), at which rounding and truncation errors are of similar size.
STEP = 1e-4
_ROW_HEIGHT = 1.9
_LEAST_RANGE_MM = 0.01


@dataclass(frozen=True)
class WrappedPath:
    """Length and moment arms of a path over a movement by one wrapping mode.

    Parameters
    ----------
    length
        Path length, m.
    moment_arm
        Moment arm by the wrapping mode, m/rad.
    slope
        -dL/dq of the same length by central differences, m/rad.
    """

    length: Float[np.ndarray, " frame"]
    moment_arm: Float[np.ndarray, "coordinate frame"]
    slope: Float[np.ndarray, "coordinate frame"]

    @property
    def disagreement(self) -> float:
        """Largest difference between moment arm and -dL/dq, m/rad."""
        return float(np.abs(self.moment_arm - self.slope).max())


@dataclass(frozen=True)
class WrappingModes:
    """One muscle's path over a movement by both wrapping modes, with the coordinates that it spans."""

    muscle: str
    coordinates: tuple[str, ...]
    opensim: WrappedPath
    shortest: WrappedPath


def compare_wrapping_modes(
    model: ModelDescription,
    muscle: str,
    coordinates: Sequence[str],
    poses: Float[np.ndarray, "frame coordinate"],
    parameters: Float[np.ndarray, "wrap wrap_parameter"] | None = None,
) -> WrappingModes:
    """Compute a muscle's path by both wrapping modes in every frame of a movement.

    Parameters
    ----------
    model
        Model description from `wrapjax.osim.model.describe_model`.
    muscle
        Name of the muscle.
    coordinates, poses
        Names and values (rad or m) of coordinates. The result contains those that the muscle spans.
    parameters
        Wrap parameters of the muscle's cylinders in the order of its path, in the order of
        `WRAP_PARAMETERS`; nominal if not given.

    Raises
    ------
    InputError
        If the path has an element that the exact engine does not support.
    """
    engine = ExactPaths(model, (muscle,), coordinates)
    spanned = [name for name in coordinates if name in model.spanned_by(muscle)]
    columns = [engine.coordinates.index(name) for name in spanned]
    # Every frame without a step, and with a step to either side along each coordinate.
    steps = STEP * np.eye(len(engine.coordinates))[columns]
    shifts = np.concatenate([np.zeros((1, steps.shape[1])), steps, -steps])
    posed = engine.posed((poses[None] + shifts[:, None]).reshape(-1, poses.shape[1]))[muscle]
    placed = nominal_parameters(len(engine.wraps_of(muscle))) if parameters is None else parameters

    def wrapped(wrapping: Wrapping) -> WrappedPath:
        path = wrap_at_samples(posed, placed[None], wrapping)
        length = np.asarray(path.length[0]).reshape(len(shifts), len(poses))
        ahead, behind = np.split(length[1:], 2)
        return WrappedPath(
            length=length[0],
            moment_arm=np.asarray(path.moment_arm[0, : len(poses)])[:, columns].T,
            slope=(behind - ahead) / (2.0 * STEP),
        )

    return WrappingModes(muscle, tuple(spanned), wrapped(PARITY), wrapped(GEODESIC))


@in_style
def wrapping_modes_figure(compared: Sequence[WrappingModes]) -> Figure:
    """Draw length and moment arms over the gait cycle, and below each the difference from the shortest path.

    One pair of rows a muscle. The lower row states the largest difference of OpenSim's length, and of
    OpenSim's moment arm and -dL/dq. Frames are assumed to be evenly spaced from 0 to 100 % of a cycle.
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
        below[0].set_ylabel("difference from\nshortest path (mm)")
    for panel in panels[-1]:
        if panel.figure is not None:
            panel.set_xlabel("gait cycle (%)")
    mark_gait_cycle(panels[0, 0], step=20)
    legend_above(figure, panels[1, 1])
    return figure


def _draw_length(above: Axes, below: Axes, one: WrappingModes) -> None:
    longer = one.opensim.length - one.shortest.length
    above.set_title(f"{one.muscle}: length", loc="left", parse_math=False)
    _draw_curve(above, one.opensim.length, VERMILION, linewidth=2.4, alpha=0.5)
    _draw_curve(above, one.shortest.length, BLUE)
    below.set_title(f"largest: {_mm(longer)} mm", loc="left")
    _draw_curve(below, longer, VERMILION, linewidth=2.4, alpha=0.5)
    _set_difference_range(below)


def _draw_arm(above: Axes, below: Axes, one: WrappingModes, row: int, name: str) -> None:
    reference = one.shortest.moment_arm[row]
    above.set_title(f"moment arm, {name}", loc="left", parse_math=False)
    for panel, origin in ((above, 0.0), (below, reference)):
        arms = (one.opensim.moment_arm[row] - origin, one.shortest.moment_arm[row] - origin)
        slopes = (one.opensim.slope[row] - origin, one.shortest.slope[row] - origin)
        _draw_curve(panel, arms[0], VERMILION, linewidth=2.4, alpha=0.5, label="OpenSim: moment arm")
        _draw_curve(panel, slopes[0], VERMILION, linestyle=":", label="OpenSim: -dL/dq")
        _draw_curve(panel, arms[1], BLUE, label="shortest path: moment arm")
        _draw_curve(panel, slopes[1], GRAY, linestyle=(0, (2, 4)), label="shortest path: -dL/dq")
    arm, slope = (_mm(values[row] - reference) for values in (one.opensim.moment_arm, one.opensim.slope))
    below.set_title(f"largest: {arm} and {slope} mm", loc="left")
    _set_difference_range(below)


def _draw_curve(panel: Axes, values: Float[np.ndarray, " frame"], color: str, **style: object) -> None:
    panel.plot(np.linspace(0.0, 100.0, values.size), 1e3 * values, color=color, **style)


def _set_difference_range(below: Axes) -> None:
    """Draw a zero line, and keep a minimum range so that rounding errors do not fill the panel."""
    draw_zero_line(below)
    low, high = below.get_ylim()
    missing = max(0.0, _LEAST_RANGE_MM - (high - low))
    below.set_ylim(low - 0.5 * missing, high + 0.5 * missing)


def _mm(values: Float[np.ndarray, " frame"]) -> str:
    largest = 1e3 * float(np.abs(values).max())
    return f"{largest:.2g}" if largest >= 1e-3 else "< 0.001"
