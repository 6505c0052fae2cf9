"""Which samples of a muscle's cylinders count as physiological: a picture, so that a person can judge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.report.cycles import mark_gait_cycle
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GREEN,
    PAGE_WIDTH,
    PURPLE,
    VERMILION,
    Figure,
    in_style,
    panel_grid,
)
from wrapjax.report.wording import plain

#: At most so many samples of a kind are drawn, unless the caller says otherwise.
MOST_CURVES = 25
#: Colors of what paths are rejected for, in this order; smoothness and deviation share theirs.
_COLORS = {
    "jumps": VERMILION,
    "never_touches": PURPLE,
    "length_step": GREEN,
    "moment_arm_step": GREEN,
    "length_deviation": "#E69F00",
    "moment_arm_deviation": "#E69F00",
    "variability": "#E69F00",
}


@dataclass(frozen=True)
class SampledPath:
    """A muscle's path at samples of its cylinders, over one recorded cycle.

    Parameters
    ----------
    muscle
        Name.
    nominal, nominal_arms
        The nominal path's length and its moment arms by coordinate, m.
    length, moment_arms
        Of all samples.
    faults
        By criterion, which samples fail it (`PathMeasures.faults`).
    """

    muscle: str
    nominal: Float[np.ndarray, " frame"]
    nominal_arms: Mapping[str, Float[np.ndarray, " frame"]]
    length: Float[np.ndarray, "sample frame"]
    moment_arms: Mapping[str, Float[np.ndarray, "sample frame"]]
    faults: Mapping[str, Bool[np.ndarray, " sample"]]

    @property
    def accepted(self) -> Bool[np.ndarray, " sample"]:
        """The samples that fail no criterion."""
        return ~np.any(list(self.faults.values()), axis=0)


@in_style
def physiological_figure(path: SampledPath, most_curves: int = MOST_CURVES) -> Figure:
    """Draw accepted and rejected paths over one recorded cycle.

    Upper row: accepted ones. Lower row: rejected ones, in the color of the first criterion they fail.
    Columns: what length differs from nominal by, then each moment arm.

    Parameters
    ----------
    path
        What was sampled.
    most_curves
        Draw at most so many samples of either kind.
    """
    accepted = path.accepted
    columns = 1 + len(path.moment_arms)
    figure, panels = panel_grid(2 * columns, columns, width=PAGE_WIDTH, panel_height=2.1, sharex=True)
    quantities = {"length (mm)\nless nominal": path.length - path.nominal}
    quantities |= {f"moment arm (mm)\n{name}": arms for name, arms in path.moment_arms.items()}
    usual = [0.0 * path.nominal, *path.nominal_arms.values()]
    percent = np.linspace(0.0, 100.0, path.nominal.size, endpoint=False)
    first = _first_fault(path.faults)
    for row, kept in enumerate((accepted, ~accepted)):
        drawn = np.flatnonzero(kept)
        drawn = drawn[:: max(1, -(-len(drawn) // most_curves))]
        for column, (title, values) in enumerate(quantities.items()):
            panel = panels[row * columns + column]
            for sample in drawn:
                color = BLUE if accepted[sample] else _COLORS[first[sample]]
                panel.plot(percent, 1e3 * values[sample], color=color, linewidth=0.7, alpha=0.7)
            panel.plot(percent, 1e3 * usual[column], color=BLACK, linewidth=1.6)
            if row == 0:
                panel.set_title(title, loc="left", parse_math=False)
            else:
                panel.set_xlabel("gait cycle (%)")
            mark_gait_cycle(panel, step=50)
        panels[row * columns].set_ylabel(f"{'accepted' if row == 0 else 'rejected'}: {kept.sum()}")
    _explain(figure, path.muscle, path.faults)
    return figure


def _first_fault(faults: Mapping[str, Bool[np.ndarray, " sample"]]) -> list[str]:
    """Name the first criterion that each sample fails; the first of all where it fails none."""
    names = list(faults)
    return [names[place] for place in np.argmax(list(faults.values()), axis=0)]


def _explain(figure: Figure, muscle: str, faults: Mapping[str, Bool[np.ndarray, " sample"]]) -> None:
    from matplotlib.lines import Line2D

    found = {name: int(failed.sum()) for name, failed in faults.items() if failed.any()}
    handles = [Line2D([], [], color=BLACK), Line2D([], [], color=BLUE)]
    handles += [Line2D([], [], color=_COLORS[name]) for name in found]
    labels = [f"{muscle}, nominal", "accepted"]
    labels += [f"{plain(name)}: {count}" for name, count in found.items()]
    figure.legend(handles, labels, loc="outside upper left", ncols=min(5, len(labels)))
