"""Regression gate: limits, tolerances and comparison with an earlier run."""

import dataclasses
import json
import math

import pytest

from benchmarks import gate
from benchmarks.gate_limits import ANY, LIMITS_FILE, Limit, read_limits, violations_of
from benchmarks.metric import INFORMATION, TOLERANCES, Metric
from benchmarks.regressions import regressions, worsening
from benchmarks.run_file import read_run, write_run
from wrapjax.errors import InputError

COST = Metric("solve/wrapjax/cost", 17.0, "1", "lower")
SPEEDUP = Metric("kernels/jacobian_speedup", 40.0, "x", "higher")
SECONDS = Metric("solve/wrapjax", 2.0, "s", "lower")
RUN = (COST, SPEEDUP, SECONDS)


def valued(metric: Metric, value: float) -> Metric:
    return dataclasses.replace(metric, value=value)


def compared(metrics, *, same_machine=True, same_set=True):
    before = {metric.name: metric for metric in RUN}
    return regressions(before, metrics, same_machine=same_machine, same_set=same_set)


@pytest.mark.parametrize(
    ("metric", "now", "worse"),
    [
        (COST, 17.0, False),
        (COST, 17.01, False),
        (COST, 17.02, True),
        (COST, 12.0, False),
        (SPEEDUP, 32.0, False),
        (SPEEDUP, 30.0, True),
        (SPEEDUP, 400.0, False),
        (SECONDS, 3.9, False),
        (SECONDS, 4.1, True),
        (SECONDS, math.nan, True),
    ],
)
def test_each_metric_has_its_own_tolerance_and_direction(metric, now, worse):
    metrics = [valued(one, now) if one is metric else one for one in RUN]
    assert [sentence.split(":")[0] for sentence in compared(metrics)] == [metric.name] * worse


def test_missing_metric_is_reported_in_the_same_set_only():
    assert compared(RUN[:2]) == ["solve/wrapjax: not measured any more"]
    assert compared(RUN[:2], same_set=False) == []
    new = Metric("kernels/other", 1.0, "ms", "lower")
    assert compared([*RUN, new]) == []


def test_costs_but_no_times_are_compared_between_machines():
    metrics = [valued(SECONDS, 100.0), valued(COST, 18.0), SPEEDUP]
    assert [sentence.split(":")[0] for sentence in compared(metrics, same_machine=False)] == [COST.name]


def test_rounding_is_not_a_regression():
    rounding = Metric("kernels/jacobian_difference", 1e-13, "1", "lower", negligible=1e-9)
    assert worsening(1e-15, rounding) == 0.0
    assert worsening(1e-15, valued(rounding, 1e-8)) > 1e3
    programs = Metric("recompilation/second_solve", 1, "programs", "lower")
    assert worsening(0, programs) == math.inf


def test_informative_metric_is_not_a_regression():
    peer = Metric("solve/peer", 1.0, "s", "lower", tolerance=INFORMATION)
    before = {peer.name: peer}
    assert regressions(before, [valued(peer, 1e6)], same_machine=True, same_set=True) == []


def test_violated_limits_are_described():
    limits = {
        SPEEDUP.name: Limit(at_least=20.0),
        COST.name: Limit(recorded=17.0, within=1e-3),
        "growth/muscles/slope": Limit(at_most=1.5),
    }
    slope = Metric("growth/muscles/slope", 1.2, "slope", "lower")
    assert violations_of([*RUN, slope], limits) == []
    violating = [valued(SPEEDUP, 19.0), valued(COST, 16.9), valued(slope, 1.6)]
    assert violations_of(violating, limits) == [
        "kernels/jacobian_speedup: 19 x, must be at least 20",
        "solve/wrapjax/cost: 16.9 1, recorded value 17: 0.59 % off, 0.1 % allowed",
        "growth/muscles/slope: 1.6 slope, must be at most 1.5",
    ]
    assert violations_of([SPEEDUP, COST], limits) == ["growth/muscles/slope: not measured"]
    unknown = [valued(SPEEDUP, math.nan), valued(COST, math.nan), valued(slope, math.nan)]
    assert len(violations_of(unknown, limits)) == 3


def test_limits_of_a_subject_extend_those_of_all_subjects(tmp_path):
    file = tmp_path / "limits.toml"
    file.write_text('[any]\n"a" = { at_most = 1 }\n"b" = { at_most = 2 }\n[p]\n"b" = { at_most = 3 }\n')
    assert read_limits("p", file) == {"a": Limit(at_most=1), "b": Limit(at_most=3)}
    assert read_limits("q", file) == {"a": Limit(at_most=1), "b": Limit(at_most=2)}


def test_committed_limits_can_be_read():
    assert set(read_limits(ANY, LIMITS_FILE)) <= set(read_limits("s1_left", LIMITS_FILE))
    assert read_limits("s1_left", LIMITS_FILE)["kernels/jacobian_speedup"].at_least >= 20.0


def test_tolerance_of_the_unit_is_the_default():
    assert Metric("a", 1.0, "ms", "lower").allowed == TOLERANCES["ms"]
    assert Metric("a", 1.0, "ms", "lower", tolerance=0.1).as_json()["tolerance"] == 0.1


def test_run_file_is_read_as_written(tmp_path):
    file = tmp_path / "run.json"
    peer = Metric("solve/peer", math.nan, "s", "lower", "not installed", INFORMATION)
    write_run(file, "gate", "person", [*RUN, peer])
    run = read_run(file)
    assert (run.asked, run.subject) == ("gate", "person")
    assert [one.as_json() for one in run.metrics.values()][:3] == [one.as_json() for one in RUN]
    assert math.isnan(run.metrics[peer.name].value) and run.metrics[peer.name].allowed == INFORMATION
    json.loads(file.read_text())


def test_exit_status_of_the_gate(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "person"
    measured = list(RUN)
    monkeypatch.setattr(gate, "_measure", lambda folder: measured)
    monkeypatch.setattr(gate, "read_limits", lambda subject: {SPEEDUP.name: Limit(at_least=20.0)})
    for name in ("pin_threads", "set_up_jax"):
        monkeypatch.setattr(gate, name, lambda: None)
    first = tmp_path / "first.json"
    words = ["--subject", str(folder)]
    assert gate.main([*words, "--out", str(first)]) == 0
    measured[0] = valued(COST, 18.0)
    assert gate.main(words) == 0
    assert gate.main([*words, "--against", str(first)]) == 1
    assert "WORSE  solve/wrapjax/cost: 17 before, 18 1 now, 6 % worse" in capsys.readouterr().out
    assert gate.main(["--subject", str(tmp_path / "other"), "--against", str(first)]) == 2
    assert "run of subject 'person', expected a run of 'other'" in capsys.readouterr().err
    assert gate.main([*words, "--against", str(tmp_path / "none.json")]) == 2


def test_file_of_another_kind_is_rejected(tmp_path):
    file = tmp_path / "other.json"
    file.write_text('{"metrics": [{"name": 1}]}')
    with pytest.raises(InputError, match="not a file of a benchmark run"):
        read_run(file)
