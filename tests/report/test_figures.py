"""Tests of the figures of a calibration: the plotted numbers and the groups of cycles."""

import re
from dataclasses import replace

import numpy as np

from wrapjax.report.calibration.calibration_curves import (
    activation_figure,
    fiber_length_figure,
    moment_figure,
)
from wrapjax.report.calibration.parameters_and_solver import (
    bounds_figure,
    cost_figure,
    history_figure,
    place_within_bounds,
)
from wrapjax.report.cycle_panels import groups_by_speed, groups_by_speed_and_use, spread
from wrapjax.report.style import new_figure, to_svg


def _line(panel, label):
    (line,) = [line for line in panel.get_lines() if line.get_label() == label]
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def _titles(figure):
    return [panel.get_title(loc="left") for panel in figure.axes]


def test_spread_is_one_sample_standard_deviation_about_the_mean():
    shape = spread(np.array([[0.0, 1.0], [2.0, 1.0]]))
    np.testing.assert_allclose(shape.mean, [1.0, 1.0])
    np.testing.assert_allclose(shape.high - shape.mean, [2.0**0.5, 0.0])
    single = spread(np.array([[3.0, 4.0]]))
    np.testing.assert_array_equal(single.low, single.high)


def test_cycles_are_grouped_by_speed_unless_there_are_too_many(result):
    assert [(group.label, group.count) for group in groups_by_speed(result.speeds, most=2)] == [
        ("0.5 m/s", "2 cycles"),
        ("0.8 m/s", "1 cycle"),
    ]
    assert [group.label for group in groups_by_speed(result.speeds, most=1)] == [""]
    unknown = replace(result, speeds=np.full(3, np.nan))
    assert [group.label for group in groups_by_speed_and_use(unknown, most_speeds=2)] == [
        "calibration",
        "validation",
    ]
    partly = replace(result, speeds=np.array([0.5, np.nan, 0.8]))
    assert [group.label for group in groups_by_speed(partly.speeds, most=3)][-1] == "speed not given"
    assert sum(group.keep for group in groups_by_speed(partly.speeds, most=3)).tolist() == [1, 1, 1]


def test_moment_figure_has_a_panel_for_each_coordinate_and_group(result):
    figure = moment_figure(result)
    # Both cycles at 0.5 m/s are for calibration, the one at 0.8 m/s for validation.
    assert _titles(figure) == [
        "hip_flexion_l: error 2.0 N m",
        "hip_flexion_l: error 5.0 N m",
        "ankle_angle_l: error 3.0 N m",
        "ankle_angle_l: error 7.0 N m",
    ]
    percent, measured = _line(figure.axes[2], "measured")
    np.testing.assert_allclose(percent, [0, 25, 50, 75, 100])
    np.testing.assert_allclose(measured, result.measured[:2, 1].mean(axis=0))
    _, modelled = _line(figure.axes[2], "modelled")
    np.testing.assert_allclose(modelled, result.modelled[:2, 1].mean(axis=0))
    # A single cycle has no spread to draw.
    assert [len(panel.collections) for panel in figure.axes] == [2, 0, 2, 0]


def test_moment_figure_of_a_single_group(without_validation):
    pooled = replace(without_validation, speeds=np.full(3, np.nan))
    assert len(moment_figure(pooled).axes) == 2


def test_activation_figure_has_a_panel_for_each_muscle_and_a_line_for_each_speed(result):
    figure = activation_figure(result, {"iliacus_l": "hip", "soleus_l": "calf"})
    assert _titles(figure) == ["iliacus_l", "soleus_l"]
    _, slow = _line(figure.axes[1], "0.5 m/s")
    np.testing.assert_allclose(slow, result.states.activation[1, :2].mean(axis=0))
    assert [text.get_text() for text in figure.axes[1].texts] == ["calf"]


def test_fiber_lengths_show_range_and_mean_before_and_after(result):
    panel = fiber_length_figure(result).axes[0]
    for label, states in (("before calibration", result.initial_states), ("after", result.states)):
        means, _ = _line(panel, label)
        np.testing.assert_allclose(means, states.fiber.normalized_length.mean(axis=(1, 2)))
    before = panel.collections[0].get_segments()
    np.testing.assert_allclose([segment[:, 0] for segment in before], [[1.4, 1.414], [1.415, 1.429]])
    assert panel.get_xlim()[1] > 1.429


def test_parameters_at_bounds_have_their_own_marker(result):
    figure = bounds_figure(result)
    scale, length = figure.axes
    places, rows = _line(scale, "at a bound")
    assert places.tolist() == [0.0] and rows.tolist() == [0]
    places, rows = _line(scale, "after")
    np.testing.assert_allclose(places, [(1.0 / 3.0 - 0.05) / 0.95])
    places, rows = _line(length, "at a bound")
    np.testing.assert_allclose(places, [1.0])
    assert rows.tolist() == [1]
    assert [label.get_text() for label in scale.get_xticklabels()] == ["0.05", "1"]
    assert [label.get_text() for label in length.get_xticklabels()] == ["60 %", "140 %"]


def test_a_parameter_with_equal_bounds_is_drawn_in_the_middle(result):
    parameter = replace(result.freedom.parameters[0], upper=np.array([0.05, 1.0]))
    np.testing.assert_allclose(place_within_bounds(parameter, np.array([0.05, 0.05])), [0.5, 0.0])


def test_history_omits_zeros_on_a_logarithmic_scale(result):
    cost, optimality = history_figure(result).axes
    np.testing.assert_allclose(cost.get_lines()[0].get_ydata(), [80.0, 12.0, 9.0])
    np.testing.assert_allclose(optimality.get_lines()[0].get_ydata(), [2.0, 0.1, np.nan])
    assert cost.get_yscale() == optimality.get_yscale() == "log"


def test_the_largest_part_of_the_cost_comes_first(result):
    panel = cost_figure(result).axes[0]
    assert [bar.get_width() for bar in panel.patches] == [7.0, 1.5, 0.5]
    assert panel.texts[0].get_text() == "7 (77.8 %)"


def test_user_settings_of_matplotlib_are_neither_used_nor_changed(result):
    import matplotlib

    with matplotlib.rc_context({"axes.facecolor": "red", "lines.linewidth": 9.0}):
        drawn = to_svg(cost_figure(result))
        assert matplotlib.rcParams["lines.linewidth"] == 9.0
    assert "#ff0000" not in drawn
    assert "matplotlib.pyplot" not in __import__("sys").modules or not matplotlib.pyplot.get_fignums()


def test_shortened_svg_paths_are_equivalent():
    """Letters of SVG paths are omitted between points of straight lines, never within curves."""
    figure = new_figure(2.0, 2.0)
    panel = figure.subplots()
    panel.plot([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 0.0, 1.0])
    panel.plot([0.0, 3.0], [0.0, 1.0], "o")
    panel.set_title("8")
    paths = re.findall(r' d="([^"]*)"', to_svg(figure))
    line = next(path for path in paths if path.count(" ") >= 8 and not re.search("[CQz]", path))
    assert re.fullmatch(r"M( -?\d+\.?\d*){8} *\n?", line)
    curved = [path for path in paths if re.search("[CQ]", path)]
    assert len(curved) >= 2
    for path in curved:
        for command, numbers in re.findall(r"([MLCQ])([^MLCQz]*)", path):
            assert len(numbers.split()) == {"M": 2, "L": 2, "C": 6, "Q": 4}[command]
