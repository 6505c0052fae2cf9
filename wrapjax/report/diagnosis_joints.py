"""Report section of a diagnosis on uncertain places of joints: what they do to moments and calibration."""

from __future__ import annotations

import numpy as np

from wrapjax.diagnosis.joint_places import JointPlaceError
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
# Most coordinates that are listed for a joint, and the least change (N m) of one.
_MOST_LISTED, _LEAST_LISTED = 3, 0.05


def joint_places_section(places: tuple[JointPlaceError, ...]) -> str:
    """Write the report section on uncertain places of joints; empty if none is known."""
    if not places:
        return ""
    return markup.section(
        "Uncertain joints",
        markup.paragraph(
            "Centers and axes of joints are known as far as markers tell, or as people differ from a scaled "
            "model. One standard deviation changes the moments so, and moves the calibrated parameters with "
            "them, to first order."
        ),
        markup.picture(
            joint_places_figure(places),
            alternative="Change of the moments by one standard deviation of the place of each joint, in N m.",
            caption="Change of measured less predicted moments (N m, root mean square) of the coordinate "
            "that changes most, by one standard deviation of each joint's place: grey before, blue after "
            "the calibration has followed it.",
        ),
        markup.table(
            (
                "joint",
                "standard deviation",
                "known from",
                "moments that change most (N m)",
                "after calibration (N m)",
                "parameter that moves farthest (prior standard deviations)",
            ),
            [_row(one) for one in places],
            caption="Root mean square over gait cycles; the coordinates that change most, up to three.",
        ),
    )


@in_style
def joint_places_figure(places: tuple[JointPlaceError, ...]) -> Figure:
    """Draw the change of the moments (N m) by each joint's place before and after calibration."""
    rows = np.arange(len(places))
    most = [_strongest(one) for one in places]
    figure = new_figure(PAGE_WIDTH, 0.34 * len(places) + 0.9)
    panel = figure.subplots()
    before = [one.moment_sd[name] for one, name in zip(places, most, strict=True)]
    after = [one.left_sd[name] for one, name in zip(places, most, strict=True)]
    panel.barh(rows - 0.17, before, color=GRAY, height=0.32, label="before calibration")
    panel.barh(rows + 0.17, after, color=BLUE, height=0.32, label="after calibration")
    label_rows([panel], [f"{_name(one)}: {readable(name)}" for one, name in zip(places, most, strict=True)])
    panel.set_xlabel("change of moments (N m)")
    legend_above(figure, panel)
    return figure


def _strongest(place: JointPlaceError) -> str:
    return max(place.moment_sd, key=lambda name: place.moment_sd[name])


def _name(place: JointPlaceError) -> str:
    return f"{place.joint} {_QUANTITIES[place.quantity][0]}"


def _row(place: JointPlaceError) -> tuple[str, ...]:
    _, unit, factor = _QUANTITIES[place.quantity]
    strongest = sorted(place.moment_sd, key=lambda name: -place.moment_sd[name])[:_MOST_LISTED]
    listed = [name for name in strongest if place.moment_sd[name] >= _LEAST_LISTED]
    return (
        _name(place),
        f"{', '.join(f'{factor * sd:.1f}' for sd in place.sd)} {unit}",
        "markers" if place.from_markers else "scaled models",
        ", ".join(f"{readable(name)} {place.moment_sd[name]:.1f}" for name in listed),
        ", ".join(f"{readable(name)} {place.left_sd[name]:.1f}" for name in listed),
        f"{place.parameter_shift:.2f}",
    )
