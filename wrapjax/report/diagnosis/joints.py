"""Report section of a diagnosis on uncertain places of joints: what they do to moments and calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter

import numpy as np

from wrapjax.diagnosis.uncertain_joints import JointPlaceError, ParameterError, UncertainJoints
from wrapjax.geometry.exact_paths.wrapping import PARAMETERS
from wrapjax.report import markup
from wrapjax.report.formatting import readable
from wrapjax.report.style import (
    BLUE,
    GRAY,
    PAGE_WIDTH,
    Figure,
    in_style,
    label_rows,
    legend_above,
    new_figure,
)

# Words for what is uncertain, unit, and factor from SI.
_QUANTITIES = {"translation": ("center", "mm", 1e3), "orientation": ("axes", "degrees", 180.0 / np.pi)}
# Units of parameters in tables, with factors from SI.
_SHOWN_UNITS = {"m": ("mm", 1e3), "rad": ("degrees", 180.0 / np.pi)}
# Most coordinates that are listed for a joint, and the least change (N m) of one.
_MOST_LISTED, _LEAST_LISTED = 3, 0.05
# Most parameters that are listed, of wraps and of muscles.
_MOST_PARAMETERS = 10


def uncertain_joints_section(joints: UncertainJoints | None) -> str:
    """Write the report section on uncertain places of joints; empty if none is known."""
    if joints is None:
        return ""
    wraps = [one for one in joints.parameters if _is_of_wrap(one)]
    others = [one for one in joints.parameters if not _is_of_wrap(one)]
    return markup.section(
        "Uncertain joints",
        markup.paragraph(
            "Centers and axes of joints are known as far as markers tell, or as people differ from a scaled "
            "model. One standard deviation changes the moments so, and moves the calibrated parameters with "
            "them, to first order."
        ),
        markup.picture(
            uncertain_joints_figure(joints),
            alternative="Change of the moments by one standard deviation of the place of each joint, in N m.",
            caption="Change of measured less predicted moments (N m, root mean square) of the coordinate "
            "that changes most, by one standard deviation of each joint's place, and of all places together: "
            "grey before, blue after the calibration has followed it.",
        ),
        markup.table(
            (
                "joint",
                "standard deviation",
                "known from",
                "moments that change most (N m)",
                "after calibration (N m)",
                "parameter that moves farthest (in its standard deviations by noise)",
            ),
            [
                *map(_row, joints.places),
                ("all", "", "", *_changes(joints.moment_sd, joints.left_sd), _farthest(joints.parameters)),
            ],
            caption="Root mean square over gait cycles; the coordinates that change most, up to three.",
        ),
        _parameter_table("wraps", wraps),
        _parameter_table("muscles", others),
    )


def _is_of_wrap(parameter: ParameterError) -> bool:
    return parameter.name.rsplit(".", 1)[1] in PARAMETERS


def _parameter_table(owners: str, parameters: Sequence[ParameterError]) -> str:
    """Write the table of the parameters that uncertain joints move farthest; empty without any."""
    if not parameters:
        return ""
    shown = parameters[:_MOST_PARAMETERS]
    which = f"The {len(shown)} of {len(parameters)}" if len(shown) < len(parameters) else "All"
    return markup.table(
        ("parameter", "value", "standard deviation by noise", "by uncertain joints"),
        [_parameter_row(one) for one in shown],
        caption=f"{which} parameters of {owners} that uncertain joints move farthest, in standard deviations "
        "by noise; those at a bound are left out.",
    )


def _parameter_row(parameter: ParameterError) -> tuple[str, ...]:
    unit, factor = _SHOWN_UNITS.get(parameter.unit, (parameter.unit, 1.0))
    words = "" if unit == "1" else f" {unit}"
    values = (parameter.value, parameter.sd_by_noise, parameter.sd_by_joints)
    return (parameter.name, *(f"{factor * value:.3g}{words}" for value in values))


@in_style
def uncertain_joints_figure(joints: UncertainJoints) -> Figure:
    """Draw the change of moments (N m) by each joint's place, and by all, before and after calibration."""
    changes = [(_name(one), one.moment_sd, one.left_sd) for one in joints.places]
    changes.append(("all joints", joints.moment_sd, joints.left_sd))
    rows = np.arange(len(changes))
    most = [max(before.items(), key=itemgetter(1))[0] for _, before, _ in changes]
    figure = new_figure(PAGE_WIDTH, 0.34 * len(changes) + 0.9)
    panel = figure.subplots()
    before = [one[name] for (_, one, _), name in zip(changes, most, strict=True)]
    after = [one[name] for (_, _, one), name in zip(changes, most, strict=True)]
    panel.barh(rows - 0.17, before, color=GRAY, height=0.32, label="before calibration")
    panel.barh(rows + 0.17, after, color=BLUE, height=0.32, label="after calibration")
    label_rows([panel], [f"{name}: {readable(one)}" for (name, _, _), one in zip(changes, most, strict=True)])
    panel.set_xlabel("change of moments (N m)")
    legend_above(figure, panel)
    return figure


def _name(place: JointPlaceError) -> str:
    return f"{place.joint} {_QUANTITIES[place.quantity][0]}"


def _row(place: JointPlaceError) -> tuple[str, ...]:
    _, unit, factor = _QUANTITIES[place.quantity]
    shift = f"{place.parameter} {place.parameter_shift:.2f}" if place.parameter else "none"
    return (
        _name(place),
        f"{', '.join(f'{factor * sd:.1f}' for sd in place.sd)} {unit}",
        "markers" if place.from_markers else "scaled models",
        *_changes(place.moment_sd, place.left_sd),
        shift,
    )


def _changes(before: Mapping[str, float], after: Mapping[str, float]) -> tuple[str, ...]:
    """List the coordinates that change most, before and after calibration."""
    strongest = sorted(before, key=lambda name: -before[name])[:_MOST_LISTED]
    listed = [name for name in strongest if before[name] >= _LEAST_LISTED]
    return tuple(", ".join(f"{readable(name)} {of[name]:.1f}" for name in listed) for of in (before, after))


def _farthest(parameters: Sequence[ParameterError]) -> str:
    if not parameters:
        return "none"
    return f"{parameters[0].name} {parameters[0].sd_by_joints / parameters[0].sd_by_noise:.2f}"
