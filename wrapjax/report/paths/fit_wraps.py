"""Report sections of a fit on wrapping surfaces: bounds, feasibility limits, accepted and rejected paths."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.geometry.surrogates.feasibility import MIN_CLASS_SHARE
from wrapjax.geometry.surrogates.wrap_bounds import (
    MAX_USABLE_SHARE,
    MIN_USABLE_SHARE,
    NARROWER_TRANSLATIONS,
    WIDER_TRANSLATIONS,
)
from wrapjax.report import markup
from wrapjax.report.cycle_panels import mark_gait_cycle
from wrapjax.report.formatting import DASH, counted, readable
from wrapjax.report.style import (
    BLACK,
    BLUE,
    DOT,
    GRAY,
    GREEN,
    LIGHT_GRAY,
    PAGE_WIDTH,
    PURPLE,
    VERMILION,
    Figure,
    in_style,
    label_rows,
    legend_above,
    new_figure,
    panel_grid,
)

#: Default of the largest number of accepted and of rejected samples that are drawn.
MOST_CURVES = 25
#: Colors of the criteria of rejection, in order of precedence; related criteria share a color.
_COLORS = {
    "jumps": VERMILION,
    "never_touches": PURPLE,
    "length_step": GREEN,
    "moment_arm_step": GREEN,
    "length_deviation": "#E69F00",
    "moment_arm_deviation": "#E69F00",
    "variability": "#E69F00",
    "new_contact": PURPLE,
}


@dataclass(frozen=True)
class SampledPath:
    """A muscle's path at sampled placements of its surfaces, over one recorded cycle.

    Parameters
    ----------
    muscle
        Name of the muscle.
    nominal, nominal_arms
        Length of the nominal path, and its moment arms by coordinate, m.
    length, moment_arms
        Length and moment arms of all samples, m.
    faults
        Whether each sample fails each criterion (`PathMeasures.faults`).
    """

    muscle: str
    nominal: Float[np.ndarray, " frame"]
    nominal_arms: Mapping[str, Float[np.ndarray, " frame"]]
    length: Float[np.ndarray, "sample frame"]
    moment_arms: Mapping[str, Float[np.ndarray, "sample frame"]]
    faults: Mapping[str, Bool[np.ndarray, " sample"]]

    @property
    def accepted(self) -> Bool[np.ndarray, " sample"]:
        """Whether each sample fails no criterion."""
        return ~np.any(list(self.faults.values()), axis=0)


@in_style
def physiological_figure(path: SampledPath, most_curves: int = MOST_CURVES) -> Figure:
    """Draw accepted and rejected paths over one recorded cycle.

    Upper row: accepted paths. Lower row: rejected paths, in the color of the first criterion that they fail.
    Columns: difference of the length from nominal, then each moment arm.

    Parameters
    ----------
    path
        Sampled path.
    most_curves
        Largest number of accepted and of rejected samples that are drawn.
    """
    accepted = path.accepted
    columns = 1 + len(path.moment_arms)
    figure, panels = panel_grid(2 * columns, columns, width=PAGE_WIDTH, panel_height=2.1, sharex=True)
    quantities = {"length (mm)\nminus nominal": path.length - path.nominal}
    quantities |= {f"moment arm (mm)\n{name}": arms for name, arms in path.moment_arms.items()}
    nominal = [0.0 * path.nominal, *path.nominal_arms.values()]
    percent = np.linspace(0.0, 100.0, path.nominal.size, endpoint=False)
    first = _first_fault(path.faults)
    for row, chosen in enumerate((accepted, ~accepted)):
        drawn = np.flatnonzero(chosen)
        drawn = drawn[:: max(1, -(-len(drawn) // most_curves))]
        for column, (title, values) in enumerate(quantities.items()):
            panel = panels[row * columns + column]
            for sample in drawn:
                color = BLUE if accepted[sample] else _COLORS[first[sample]]
                panel.plot(percent, 1e3 * values[sample], color=color, linewidth=0.7, alpha=0.7)
            panel.plot(percent, 1e3 * nominal[column], color=BLACK, linewidth=1.6)
            if row == 0:
                panel.set_title(title, loc="left", parse_math=False)
            else:
                panel.set_xlabel("gait cycle (%)")
            mark_gait_cycle(panel, step=50)
        panels[row * columns].set_ylabel(f"{'accepted' if row == 0 else 'rejected'}: {chosen.sum()}")
    _add_legend(figure, path.muscle, path.faults)
    return figure


def _first_fault(faults: Mapping[str, Bool[np.ndarray, " sample"]]) -> list[str]:
    """Find the first criterion that each sample fails; the first criterion where it fails none."""
    names = list(faults)
    return [names[place] for place in np.argmax(list(faults.values()), axis=0)]


def _add_legend(figure: Figure, muscle: str, faults: Mapping[str, Bool[np.ndarray, " sample"]]) -> None:
    from matplotlib.lines import Line2D

    counts = {name: int(failed.sum()) for name, failed in faults.items() if failed.any()}
    handles = [Line2D([], [], color=BLACK), Line2D([], [], color=BLUE)]
    handles += [Line2D([], [], color=_COLORS[name]) for name in counts]
    labels = [f"{muscle}, nominal", "accepted"]
    labels += [f"{readable(name)}: {count}" for name, count in counts.items()]
    figure.legend(handles, labels, loc="outside upper left", ncols=min(5, len(labels)))


#: Number of accepted and of rejected samples that a page shows, so that its size stays a few megabytes.
_MOST_CURVES = 8
#: Title and factor of each column that is drawn for a surface, by key of ``fit.json``.
_COLUMNS = {
    "translation_m": ("bound of translation, ± (mm)", 1e3),
    "physiological_share": ("physiological (% of box)", 1e2),
    "balanced_accuracy": ("balanced accuracy (%)", 1e2),
    "false_physiological": ("false acceptance (%)", 1e2),
}
#: Further columns of the table, for the feasibility score alone.
_SCORE_ALONE = {
    "learned_balanced_accuracy": "score alone: balanced accuracy (%)",
    "learned_false_physiological": "score alone: false acceptance (%)",
}
#: Unit, factor and meaning of each threshold.
_THRESHOLDS = {
    "length_deviation": ("mm", 1e3, "its length differs from nominal by more in any pose"),
    "moment_arm_deviation": ("mm", 1e3, "a moment arm differs from nominal by more in any pose"),
    "variability": (
        "times",
        1.0,
        "its length or a moment arm varies by this factor more or less than nominal",
    ),
    "length_step": ("mm", 1e3, "the difference of its length from nominal changes by more between frames"),
    "moment_arm_step": (
        "mm",
        1e3,
        "the difference of a moment arm from nominal changes by more between frames",
    ),
    "new_contact": ("% of poses", 100.0, "it touches in more of them a wrap that nominal touches in none"),
    "bone_distance": ("mm", 1e3, "a surface is farther from the bones of its body than nominal by more"),
}


def surface_findings(content: dict[str, Any]) -> list[str]:
    """Write a sentence on the accuracy of the feasibility limits; empty if no placements were sampled."""
    wraps = content["wraps"]
    if not wraps:
        return []
    touched = [name for name, wrap in wraps.items() if wrap["touched"]]
    accuracy = {
        name: wrap["balanced_accuracy"]
        for name, wrap in wraps.items()
        if wrap["balanced_accuracy"] is not None
    }
    sentence = (
        f"{counted(len(wraps), 'wrapping surface')} {'was' if len(wraps) == 1 else 'were'} sampled for PGA; "
        f"muscles touch {len(touched)} of them in the recorded cycles"
    )
    if not accuracy:
        return [f"{sentence}."]
    worst = min(accuracy, key=accuracy.__getitem__)
    median = 100.0 * float(np.median(list(accuracy.values())))
    return [
        f"{sentence}. The balanced accuracy with which the limits separate physiological from other "
        f"placements, on held-out placements, is {median:.0f} % in the median and at least "
        f"{100.0 * accuracy[worst]:.0f} % ({worst})."
    ]


def surfaces_section(content: dict[str, Any]) -> str:
    """Write the report section on surfaces; empty if none were sampled."""
    wraps = content["wraps"]
    if not wraps:
        return ""
    usual, narrowest, widest = (
        1e3 * width for width in (NARROWER_TRANSLATIONS[0], NARROWER_TRANSLATIONS[-1], WIDER_TRANSLATIONS[-1])
    )
    return markup.section(
        "Wrapping surfaces",
        markup.paragraph(
            "PGA may translate, rotate and scale a wrapping surface within a box of bounds, and within it "
            "only where limits predict that the paths of its muscles are physiological. These limits are a "
            "feasibility score, fitted to samples, and geometric margins computed by the exact engine. Their "
            "accuracy is "
            "given for placements that were held out from fitting."
        ),
        markup.picture(
            surface_figure(content),
            alternative=f"Bounds, physiological share and accuracy of the limits of {len(wraps)} surfaces.",
            caption=f"Bound of translation: largest translation along each axis, {usual:g} mm, but less "
            f"(down to {narrowest:g} mm) where paths jump or lose contact in over "
            f"{100.0 * (1.0 - MIN_USABLE_SHARE):g} % of placements, and more (up to {widest:g} mm) where in "
            f"under {100.0 * (1.0 - MAX_USABLE_SHARE):.0f} %. Physiological: share of the box in which all "
            "criteria are fulfilled. Balanced accuracy: mean of the shares of physiological and of other "
            "placements that the limits classify correctly. False acceptance: share of other placements "
            "that the limits allow.",
        ),
        markup.table(
            (
                *("surface", "muscles", "touched"),
                *(title for title, _ in _COLUMNS.values()),
                *_SCORE_ALONE.values(),
                *(("near a bone (% of box)",) if _has_bones(content) else ()),
            ),
            [_surface_row(content, name) for name in _touched_first(content)],
            caption="The same numbers. Touched: a muscle touches the surface in the recorded cycles. PGA "
            "holds the other surfaces fixed, and those with physiological paths in less than "
            f"{100.0 * MIN_CLASS_SHARE:g} % of their box. A dash: less than {100.0 * MIN_CLASS_SHARE:g} % "
            "of placements belong to one class, too few to assess the limits.",
        ),
    )


def _surface_row(content: dict[str, Any], name: str) -> tuple[str, ...]:
    wrap = content["wraps"][name]
    muscles = [muscle for muscle, wraps in content["wraps_of"].items() if name in wraps]
    return (
        name,
        ", ".join(muscles),
        "yes" if wrap["touched"] else "no",
        *(DASH if value is None else f"{factor * value:.1f}" for value, factor in _table_values(wrap)),
        *((_percent(wrap["near_bone_share"]),) if _has_bones(content) else ()),
    )


def _has_bones(content: dict[str, Any]) -> bool:
    """Whether surfaces had to stay near bones; not so in earlier fits."""
    return any(wrap.get("near_bone_share") is not None for wrap in content["wraps"].values())


def _percent(share: float | None) -> str:
    return DASH if share is None else f"{100.0 * share:.1f}"


def _table_values(wrap: dict[str, Any]) -> Iterator[tuple[float | None, float]]:
    """Iterate over a surface's values in the table, with their factors."""
    factors = [factor for _, factor in _COLUMNS.values()]
    yield from zip(_drawn_values(wrap), factors, strict=True)
    assessed = wrap["balanced_accuracy"] is not None
    for key in _SCORE_ALONE:
        yield wrap.get(key) if assessed else None, 1e2


def _drawn_values(wrap: dict[str, Any]) -> list[float | None]:
    """Collect a surface's values in the figure; no false acceptance where the limits cannot be assessed."""
    assessed = wrap["balanced_accuracy"] is not None
    return [wrap[key] if assessed or key != "false_physiological" else None for key in _COLUMNS]


def _touched_first(content: dict[str, Any]) -> list[str]:
    wraps = content["wraps"]
    return sorted(wraps, key=lambda name: (not wraps[name]["touched"], name))


@in_style
def surface_figure(content: dict[str, Any]) -> Figure:
    """Draw bounds, physiological share and accuracy of the limits, one row a surface."""
    order = _touched_first(content)
    rows = np.arange(len(order))
    touched = np.array([content["wraps"][name]["touched"] for name in order])
    table = np.array([_drawn_values(content["wraps"][name]) for name in order], dtype=float)
    figure = new_figure(PAGE_WIDTH, 0.18 * len(rows) + 1.2)
    panels = figure.subplots(1, len(_COLUMNS), sharey=True)
    for panel, (title, factor), values in zip(panels, _COLUMNS.values(), table.T, strict=True):
        panel.hlines(rows, 0.0, 1.0, transform=panel.get_yaxis_transform(), color=LIGHT_GRAY, linewidth=0.8)
        for kind, color, label in (
            (touched, BLUE, "touched in the recorded cycles"),
            (~touched, GRAY, "never touched"),
        ):
            if kind.any():
                panel.plot(factor * values[kind], rows[kind], "o", color=color, label=label, **DOT)
        panel.set_title(title, loc="left")
        panel.tick_params(axis="y", pad=6)
    for panel, high in zip(panels, (None, 103.0, 103.0, None), strict=True):
        panel.set_xlim(0.0, high)
    # The balanced accuracy of a random classification is 50 %.
    panels[2].set_xlim(left=50.0)
    label_rows(panels, order)
    legend_above(figure, panels[0])
    return figure


def sampled_paths_section(content: dict[str, Any], paths: Iterable[SampledPath]) -> str:
    """Write the report section that shows accepted and rejected paths; empty if there are none.

    Parameters
    ----------
    content
        Content of ``fit.json``.
    paths
        Sampled paths, which are drawn one at a time.
    """
    pictures = [_picture(content, path) for path in paths]
    if not pictures:
        return ""
    by_engine = ""
    if content["geometry"] == "opensim":
        by_engine = (
            " The paths shown here and their classification are from the exact engine; those used in the fit "
            "are from OpenSim."
        )
    rows = [
        (
            "jumps",
            DASH,
            "it enters a surface, slips off its end or wraps over more than half of it, unlike the nominal "
            "path",
        ),
        ("never touches", DASH, "it touches in no pose a surface that the nominal path touches"),
    ]
    rows += [
        (readable(name), f"{factor * content['thresholds'][name]:g} {unit}", words)
        for name, (unit, factor, words) in _THRESHOLDS.items()
        # Earlier fits lack some, and not every fit has bones.
        if name in content["thresholds"] and (name != "bone_distance" or _has_bones(content))
    ]
    return markup.section(
        "Accepted and rejected paths",
        markup.paragraph(
            "Each line is one placement of the muscle's surfaces over one recorded cycle; black is the "
            "nominal placement. Blue lines should be physiologically plausible and the others should not. If "
            "they are not, change the thresholds: wrapjax fit has an option for each. In Python "
            "wrapjax.physiological_picture(subject, fit, muscle, thresholds) draws a picture "
            f"anew.{by_engine}"
        ),
        *pictures,
        markup.table(
            ("criterion", "threshold", "a path is rejected if"),
            rows,
            caption="Criteria of rejection, applied in all poses; changes between frames are along one "
            "recorded cycle. Thresholds are wrapjax.PhysiologicalThresholds.",
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
            f"rejected placements of its surfaces: {share}.",
            caption=f"{path.muscle}: accepted placements above, rejected placements below, colored by the "
            f"first criterion that they fail. At most {_MOST_CURVES} of each are drawn; the numbers count "
            "all placements, and those that fail several criteria are counted for each criterion.",
        ),
    )
