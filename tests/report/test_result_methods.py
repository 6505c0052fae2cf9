"""Every public result summarizes and draws itself, and its summary is what it writes."""

import json

import pytest
from matplotlib.figure import Figure

import wrapjax
from tests.report.synthetic_diagnosis import insufficient_data, named
from wrapjax.diagnosis.diagnosis import Diagnosis
from wrapjax.errors import InputError
from wrapjax.evaluation.evaluation import Evaluation
from wrapjax.evaluation.stored_run import load_run
from wrapjax.io.files import to_json_values

#: Public results, by what the command of the same name writes.
RESULTS = (
    wrapjax.Calibration,
    wrapjax.Cohort,
    wrapjax.Comparison,
    wrapjax.ConditionDifference,
    wrapjax.Contact,
    wrapjax.Diagnosis,
    wrapjax.Evaluation,
    wrapjax.Fit,
    wrapjax.JointPersonalisation,
    wrapjax.Protocol,
    wrapjax.Uncertainty,
)


def drawn(result, without=()):
    """Call all methods that draw, but some."""
    names = [name for name in dir(result) if name.startswith("plot_") and name not in without]
    return {name: getattr(result, name)() for name in names}


@pytest.mark.parametrize("result", RESULTS, ids=lambda one: one.__name__)
def test_every_result_has_a_summary_and_a_figure(result):
    assert callable(result.summary)
    methods = [getattr(result, name) for name in dir(result) if name.startswith("plot_")]
    assert methods and all(one.__annotations__["return"] == "Figure" for one in methods)
    assert result.to_dataset.__annotations__["return"] == "Dataset"


def test_a_calibration_summarizes_what_it_writes_and_draws_itself(calibrated, tmp_path):
    calibrated.save(tmp_path / "run")
    written = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert written == to_json_values(calibrated.summary())
    with pytest.raises(InputError, match="NGA changed none"):
        calibrated.plot_moment_arms()
    figures = drawn(calibrated, without=("plot_moment_arms",))
    assert all(isinstance(figure, Figure) and figure.axes for figure in figures.values())
    titles = [panel.get_title(loc="left") for panel in figures["plot_moments"].axes]
    assert [title.split(":")[0] for title in titles[::2]] == list(calibrated.result.coordinates)


def test_an_evaluation_summarizes_what_it_writes_and_draws_itself(calibrated, person, tmp_path):
    calibrated.save(tmp_path / "run")
    found = Evaluation(load_run(tmp_path / "run"), person, person.trials.moments + 1.0, ())
    found.save(tmp_path / "evaluation")
    written = json.loads((tmp_path / "evaluation" / "evaluation.json").read_text())
    assert written == to_json_values(found.summary())
    assert drawn(found)["plot_moments"].axes


def test_a_diagnosis_draws_where_the_error_lies_or_says_why_not(calibrated):
    def of(result):
        diagnosis = object.__new__(Diagnosis)
        object.__setattr__(diagnosis, "calibration", calibrated)
        object.__setattr__(diagnosis, "result", result)
        return diagnosis

    found = of(named())
    assert found.summary()["outcome"] == "named" and found.summary()["subject"] == calibrated.subject.name
    assert all(figure.axes for figure in drawn(found).values())
    with pytest.raises(InputError, match="cycles"):
        of(insufficient_data()).plot_error_map()
