"""Which samples of a muscle's cylinders count as physiological: a picture, so that a person can judge.

How the cylinders of a fit were sampled: words, figure, table, and pictures of sampled paths.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.geometry.feasibility import RAREST_SHARE
from wrapjax.geometry.wrap_bounds import LEAST_USABLE, MOST_USABLE, NARROWER, WIDER
from wrapjax.report import markup
from wrapjax.report.moment_curves import mark_gait_cycle
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    GREEN,
    LIGHT_GRAY,
    PAGE_WIDTH,
    PURPLE,
    VERMILION,
    Figure,
    counted,
    in_style,
    new_figure,
    panel_grid,
    plain,
)

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


#: As many samples of a kind are drawn: all muscles' pictures together stay a few megabytes.
_MOST_CURVES = 8
_DASH = "\N{EN DASH}"
# Whole where they stand on an axis.
_DOT: dict[str, Any] = {"markersize": 4.2, "zorder": 3, "clip_on": False}
#: What is drawn of each cylinder: by key of ``fit.json``, title and factor.
_COLUMNS = {
    "translation_m": ("box, to either side (mm)", 1e3),
    "physiological_share": ("physiological (% of box)", 1e2),
    "balanced_accuracy": ("limits are right (%)", 1e2),
    "false_physiological": ("passed by mistake (%)", 1e2),
}
#: What stands in the table beside it, of the learned limit alone.
_LEARNED_ALONE = {
    "learned_balanced_accuracy": "learned alone: right (%)",
    "learned_false_physiological": "learned alone: passed by mistake (%)",
}
#: What thresholds say, by name: unit, factor, and what is held to them.
_THRESHOLDS = {
    "length_deviation": ("mm", 1e3, "length differs from nominal by more, in some pose"),
    "moment_arm_deviation": ("mm", 1e3, "a moment arm differs from nominal by more, in some pose"),
    "variability": ("times", 1.0, "length or a moment arm varies so much more, or less, than nominal"),
    "length_step": ("mm", 1e3, "what length differs by changes by more from one frame to the next"),
    "moment_arm_step": ("mm", 1e3, "likewise a moment arm"),
}


def cylinder_findings(content: dict[str, Any]) -> list[str]:
    """Say in a plain sentence how well limits sort placements; nothing where none were sampled."""
    wraps = content["wraps"]
    if not wraps:
        return []
    touched = [name for name, own in wraps.items() if own["touched"]]
    known = {name: own for name, own in wraps.items() if own["balanced_accuracy"] is not None}
    sentence = (
        f"{counted(len(wraps), 'cylinder')} {'was' if len(wraps) == 1 else 'were'} sampled for PGA; muscles "
        f"lie on {len(touched)} of them in the recorded cycles"
    )
    if not known:
        return [f"{sentence}."]
    accuracy = {name: own["balanced_accuracy"] for name, own in known.items()}
    worst = min(accuracy, key=accuracy.__getitem__)
    median = 100.0 * float(np.median(list(accuracy.values())))
    return [
        f"{sentence}. What limits allow and forbid is right for {median:.0f} % of unseen placements in "
        f"the median (either kind counting half), for {100.0 * accuracy[worst]:.0f} % at worst ({worst})."
    ]


def cylinders_section(content: dict[str, Any]) -> str:
    """Write the part of the report on cylinders; empty where none were sampled."""
    wraps = content["wraps"]
    if not wraps:
        return ""
    usual, narrowest, widest = (1e3 * width for width in (NARROWER[0], NARROWER[-1], WIDER[-1]))
    return markup.section(
        "Cylinders",
        markup.paragraph(
            "PGA may move, turn and scale a cylinder within a box, and there within limits that keep the "
            "paths of its muscles physiological: a learned one, and the exact engine's margins. How they "
            "came out, on placements not used in fitting:"
        ),
        markup.picture(
            cylinder_figure(content),
            alternative=f"Box, physiological share and quality of the limits of {len(wraps)} cylinders.",
            caption=f"Box: how far a cylinder may move along each axis, {usual:g} mm, but less (down to "
            f"{narrowest:g} mm) where paths jump or lose it in over {100.0 * (1.0 - LEAST_USABLE):g} % of "
            f"placements, and more (up to {widest:g} mm) where in under {100.0 * (1.0 - MOST_USABLE):.0f} %. "
            "Physiological: the share of the box that passes all criteria. Limits are right: balanced "
            "accuracy, the mean of the shares of physiological and of other placements that they sort "
            "rightly. Passed by mistake: the share of other placements that they allow.",
        ),
        markup.table(
            (
                *("cylinder", "muscles", "touched"),
                *(title for title, _ in _COLUMNS.values()),
                *_LEARNED_ALONE.values(),
            ),
            [_row(content, name) for name in _touched_first(content)],
            caption="The same in numbers. Touched: some muscle lies on it in the recorded cycles; PGA holds "
            f"the others, and those physiological in less than {100.0 * RAREST_SHARE:g} % of their box. A "
            f"dash: less than {100.0 * RAREST_SHARE:g} % of placements are of one kind, too few to judge "
            "limits by.",
        ),
    )


def _row(content: dict[str, Any], name: str) -> tuple[str, ...]:
    own = content["wraps"][name]
    muscles = [muscle for muscle, wraps in content["wraps_of"].items() if name in wraps]
    return (
        name,
        ", ".join(muscles),
        "yes" if own["touched"] else "no",
        *(_DASH if value is None else f"{factor * value:.1f}" for value, factor in _shown(own)),
    )


def _shown(own: dict[str, Any]) -> Iterator[tuple[float | None, float]]:
    """Give the table's numbers of a cylinder, and their factors."""
    factors = [factor for _, factor in _COLUMNS.values()]
    yield from zip(_values(own), factors, strict=True)
    judged = own["balanced_accuracy"] is not None
    for key in _LEARNED_ALONE:
        yield own.get(key) if judged else None, 1e2


def _values(own: dict[str, Any]) -> list[float | None]:
    """Read off what is shown of a cylinder; where limits cannot be judged, not how often they err either."""
    judged = own["balanced_accuracy"] is not None
    return [own[key] if judged or key != "false_physiological" else None for key in _COLUMNS]


def _touched_first(content: dict[str, Any]) -> list[str]:
    wraps = content["wraps"]
    return sorted(wraps, key=lambda name: (not wraps[name]["touched"], name))


@in_style
def cylinder_figure(content: dict[str, Any]) -> Figure:
    """Draw how each cylinder fared, one row a cylinder."""
    order = _touched_first(content)
    rows = np.arange(len(order))
    touched = np.array([content["wraps"][name]["touched"] for name in order])
    table = np.array([_values(content["wraps"][name]) for name in order], dtype=float)
    figure = new_figure(PAGE_WIDTH, 0.18 * len(rows) + 1.2)
    panels = figure.subplots(1, len(_COLUMNS), sharey=True)
    for panel, (title, factor), values in zip(panels, _COLUMNS.values(), table.T, strict=True):
        panel.hlines(rows, 0.0, 1.0, transform=panel.get_yaxis_transform(), color=LIGHT_GRAY, linewidth=0.8)
        for kind, color, label in (
            (touched, BLUE, "touched in the recorded cycles"),
            (~touched, GRAY, "never touched"),
        ):
            if kind.any():
                panel.plot(factor * values[kind], rows[kind], "o", color=color, label=label, **_DOT)
        panel.set_title(title, loc="left")
        panel.tick_params(axis="y", length=0, pad=6)
    for panel, high in zip(panels, (None, 103.0, 103.0, None), strict=True):
        panel.set_xlim(0.0, high)
    # Chance is right half the time.
    panels[2].set_xlim(left=50.0)
    panels[0].set_yticks(rows, order, parse_math=False)
    panels[0].set_ylim(len(rows) - 0.4, -0.6)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    return figure


def pictures_section(content: dict[str, Any], paths: Iterable[SampledPath]) -> str:
    """Write the part of the report that shows accepted and rejected paths; empty where there are none.

    Parameters
    ----------
    content
        Of ``fit.json``.
    paths
        Taken one at a time, as they may come.
    """
    pictures = [_picture(content, path) for path in paths]
    if not pictures:
        return ""
    by_engine = ""
    if content["geometry"] == "opensim":
        by_engine = (
            " What is drawn, and its verdicts, are the exact engine's; those of the fit are OpenSim's."
        )
    rows = [
        ("jumps", _DASH, "it comes inside a cylinder, off its end or over half round it; nominal does not"),
        ("never touches", _DASH, "it lies in no pose on a cylinder that the nominal path lies on"),
    ]
    rows += [
        (plain(name), f"{factor * content['thresholds'][name]:g} {unit}", words)
        for name, (unit, factor, words) in _THRESHOLDS.items()
    ]
    return markup.section(
        "Accepted and rejected paths",
        markup.paragraph(
            "Each line is one placement of the muscle's cylinders over one recorded cycle, black the model's "
            "own: blue lines should look like paths that a muscle can take, the others should not. Where you "
            "disagree, change the thresholds: wrapjax fit has an option for each. In Python "
            "wrapjax.physiological_picture(subject, fit, muscle, thresholds) draws a picture "
            f"anew.{by_engine}"
        ),
        *pictures,
        markup.table(
            ("criterion", "threshold", "a path is rejected if"),
            rows,
            caption="What was held against paths, in all poses; steps along one recorded cycle. Thresholds "
            "are wrapjax.geometry.physiological.PhysiologicalThresholds.",
        ),
    )


def _picture(content: dict[str, Any], path: SampledPath) -> str:
    wraps = ", ".join(content["wraps_of"][path.muscle])
    share = f"{path.accepted.sum()} of {path.accepted.size} accepted"
    return markup.folded(
        f"{path.muscle} ({wraps}): {share}",
        markup.picture(
            physiological_figure(path, _MOST_CURVES),
            alternative=f"Length and moment arms of {path.muscle} over the gait cycle at accepted and at "
            f"rejected placements of its cylinders: {share}.",
            caption=f"{path.muscle}: accepted placements above, rejected ones below, colored by the first "
            f"criterion they fail. At most {_MOST_CURVES} of either are drawn; numbers count all, and those "
            "that fail several criteria at each.",
        ),
    )
