"""Tables of methods: every leg has its lines, and what means are over is said."""

from benchmarks.compare_methods import describe, markdown
from tests.subject.synthetic import write_subject
from wrapjax import calibrate, load_subject
from wrapjax.comparison.comparison import Comparison


def test_every_leg_and_method_is_told(tmp_path):
    """What another method would have found is of no interest here."""
    methods, labels = ("NGA", "SGA"), ("anna", "ben")
    one = calibrate(load_subject(write_subject(tmp_path / "anna")), "NGA", starts=1)
    done = Comparison(methods, ((one, one), (one, one)), labels)
    text = list(markdown(done))
    told = [cells[:2] for cells in (line.strip("| ").split(" | ") for line in text) if len(cells) == 9]
    assert told[2:] == [[label, method] for label in labels for method in methods]
    assert any("standard deviation over cycles" in line for line in text)
    found = describe(done)
    assert found["unit_of_analysis"] == "cycle" and set(found["legs"]) == set(labels)
    calibrated = [row for row in found["methods"]["SGA"]["mae_Nm"] if row["use"] == "calibration"]
    assert {row["n"] for row in calibrated} == {4}, "two cycles of each of two people"
