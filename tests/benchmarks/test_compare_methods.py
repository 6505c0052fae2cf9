"""Tables of the comparison of methods: lines for every leg, and the unit of analysis of the means."""

from benchmarks.compare_methods import describe, markdown
from tests.subject.synthetic import write_subject
from wrapjax import calibrate, load_subject
from wrapjax.comparison.comparison import Comparison


def test_tables_have_a_line_for_every_leg_and_method(tmp_path):
    """Check the layout only; one calibration stands for all methods."""
    methods, labels = ("NGA", "SGA"), ("anna", "ben")
    one = calibrate(load_subject(write_subject(tmp_path / "anna")), "NGA", starts=1)
    done = Comparison(methods, ((one, one), (one, one)), labels)
    text = list(markdown(done))
    listed = [cells[:2] for cells in (line.strip("| ").split(" | ") for line in text) if len(cells) == 9]
    assert listed[2:] == [[label, method] for label in labels for method in methods]
    assert any("standard deviation over cycles" in line for line in text)
    content = describe(done)
    assert content["unit_of_analysis"] == "cycle" and set(content["legs"]) == set(labels)
    calibrated = [row for row in content["methods"]["SGA"]["mae_Nm"] if row["use"] == "calibration"]
    assert {row["n"] for row in calibrated} == {4}, "two cycles of each of two people"
