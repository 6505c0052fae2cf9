"""Errors of all subjects in one figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from wrapjax.report.cohort.content import errors_by_coordinate
from wrapjax.report.style import BLUE, GRAY, LIGHT_GRAY, PAGE_WIDTH, VERMILION, Figure, in_style, new_figure
from wrapjax.report.summary import USES
from wrapjax.report.wording import plain

_COLORS = dict(zip(USES, (BLUE, VERMILION), strict=True))
# Subjects of one coordinate side by side, over this part of its place.
_WIDTH = 0.28


@in_style
def population_figure(subjects: list[Mapping[str, Any]]) -> Figure:
    """Draw the mean absolute error (N m) of every subject by coordinate, and the median over subjects.

    Parameters
    ----------
    subjects
        Those that are done; at least one.
    """
    errors = {use: errors_by_coordinate(subjects, "mae_Nm", use) for use in USES}
    names = list(errors["calibration"] or errors["validation"])
    uses = [use for use in USES if errors[use]]
    figure = new_figure(PAGE_WIDTH, 3.2)
    panel = figure.subplots()
    for place in range(1, len(names)):
        panel.axvline(place - 0.5, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
    for number, use in enumerate(uses):
        center = 0.4 * (number - 0.5 * (len(uses) - 1))
        for place, name in enumerate(names):
            values = np.array(errors[use].get(name, []))
            spread = np.linspace(-0.5, 0.5, len(values)) if len(values) > 1 else np.zeros(len(values))
            panel.plot(
                place + center + _WIDTH * spread,
                values,
                "o",
                color=_COLORS[use],
                markersize=3.6,
                alpha=0.6,
                markeredgewidth=0,
                label=f"{use}, one subject" if place == 0 else None,
            )
            if values.size:
                ends = place + center + np.array([-0.6, 0.6]) * _WIDTH
                panel.hlines(
                    np.median(values),
                    *ends,
                    color=_COLORS[use],
                    linewidth=2.0,
                    label=f"{use}, median" if place == 0 else None,
                )
    panel.set_xticks(range(len(names)), names, parse_math=False)
    panel.tick_params(axis="x", length=0)
    panel.set_xlim(-0.5, len(names) - 0.5)
    panel.set_ylim(bottom=0.0)
    panel.set_ylabel("mean absolute error (N m)")
    figure.legend(*panel.get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return figure


@in_style
def outcomes_figure(population: Mapping[str, Any]) -> Figure:
    """Draw how diagnoses ended, and which effects they named or could not tell apart.

    Parameters
    ----------
    population
        Of ``cohort.json``; at least one diagnosis.
    """
    outcomes, effects = population["outcomes"], {**population["tied"], **population["named"]}
    named = [population["named"].get(name, 0) for name in effects]
    tied = [population["tied"].get(name, 0) for name in effects]
    rows = max(len(outcomes), len(effects))
    figure = new_figure(PAGE_WIDTH, 0.24 * rows + 1.1)
    left, right = figure.subplots(1, 2)
    left.barh(range(len(outcomes)), list(outcomes.values()), color=GRAY, height=0.6)
    left.set_yticks(range(len(outcomes)), [plain(name) for name in outcomes], parse_math=False)
    left.set_title("outcome", loc="left")
    right.barh(range(len(effects)), named, color=BLUE, height=0.6, label="named")
    right.barh(range(len(effects)), tied, left=named, color=BLUE, alpha=0.35, height=0.6, label="tied")
    right.set_yticks(range(len(effects)), [plain(name) for name in effects], parse_math=False)
    right.set_title("effect", loc="left")
    for panel in (left, right):
        panel.set_ylim(rows - 0.4, -0.6)
        panel.xaxis.get_major_locator().set_params(integer=True)
        panel.set_xlabel("subjects")
        panel.tick_params(axis="y", length=0)
    if effects:
        figure.legend(*right.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    else:
        right.remove()
    return figure
