"""Tests of the figure of accepted and rejected paths: samples are classified as by the criteria."""

import numpy as np

from wrapjax.report.paths.fit_wraps import SampledPath, physiological_figure
from wrapjax.report.style import to_svg

FRAMES = 50


def test_samples_are_separated_into_accepted_and_rejected():
    nominal = 0.3 + 0.02 * np.sin(np.linspace(0.0, 6.0, FRAMES))
    length = nominal + np.array([0.0, 0.001, 0.05, 0.002])[:, None]
    arms = {"knee_angle_l": 0.1 * length}
    faults = {
        "jumps": np.array([False, False, True, False]),
        "length_step": np.array([False, False, True, True]),
    }
    path = SampledPath("psoas_l", nominal, {"knee_angle_l": 0.1 * nominal}, length, arms, faults)
    figure = physiological_figure(path)
    panels = figure.axes
    assert [panel.get_ylabel() for panel in panels] == ["accepted: 2", "", "rejected: 2", ""]
    # Every sample once, and the nominal path.
    assert [len(panel.get_lines()) for panel in panels] == [3, 3, 3, 3]
    rejected = [np.asarray(line.get_ydata()) for line in panels[2].get_lines()]
    np.testing.assert_allclose(rejected[0], 50.0)
    np.testing.assert_allclose(rejected[1], 2.0)
    colors = [line.get_color() for line in panels[2].get_lines()]
    assert len(set(colors)) == 3
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["psoas_l, nominal", "accepted", "jumps: 1", "length step: 2"]
    assert to_svg(figure).lstrip().startswith("<?xml")
