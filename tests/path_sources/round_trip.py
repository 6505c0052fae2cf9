"""Check that the evaluation of a run on its own subject reproduces its errors."""

import json
from pathlib import Path

import pytest

from wrapjax.evaluation.evaluation import evaluate
from wrapjax.evaluation.stored_run import load_run
from wrapjax.subject.subject import Subject


def assert_reproduces_itself(run: Path, subject: Subject, *, rel: float = 1e-9) -> None:
    """Check an evaluation of a run's folder on its own subject against the run's ``summary.json``."""
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    content = evaluate(load_run(run), subject).summary()
    for kind in ("mae_Nm", "rmse_Nm"):
        for use, own in summary[kind].items():
            assert content[kind][use] == pytest.approx(own, rel=rel), (kind, use)
        assert list(content["trials"]) == list(summary["trials"])
        for name, trial in summary["trials"].items():
            assert content["trials"][name][kind] == pytest.approx(trial[kind], rel=rel), (kind, name)
            assert content["trials"][name]["file"] == trial["file"]
    assert content["notes"] == []
