"""Defends: the table of what other tasks add names the cause, the strongest other effect, and both parts."""

from validation.diagnosis.added_by_tasks import places_of_cause, row


def answer(evidence, added):
    effects = [{"id": id, "evidence_nats": value} for id, value in {**evidence, "none": None}.items()]
    tasks = None if added is None else {"added_nats": added}
    return {"outcome": "named", "named": ["joint_damping"], "effects": effects, "other_tasks": tasks}


def test_evidence_is_divided_into_walking_and_other_tasks():
    truth = {"causes": [{"effect": "joint_damping", "d_star": 6.25}]}
    evidence = {"joint_damping": 7.0, "emg_drift": 1.0, "wrap_surface": 2.5}
    found = row("case001", truth, answer(evidence, {"joint_damping": 5.0, "wrap_surface": -0.5}))
    assert found == (
        "case001",
        "`joint_damping` (6.2)",
        "named, `joint_damping`",
        "2.0 +5.0",
        "`wrap_surface` 3.0 -0.5",
    )


def test_a_cause_that_cannot_be_tested_and_a_case_without_cause_are_shown():
    untestable = {"causes": [{"effect": "device_torque", "d_star": 3.0}]}
    assert row("a", untestable, answer({"emg_drift": 1.0}, None))[3] == "not testable"
    assert row("b", {"causes": []}, answer({"emg_drift": 1.0}, None))[1:4:2] == ("none", "")


def test_the_place_of_a_cause_is_that_by_walking_and_by_all_tasks():
    truth = {"causes": [{"effect": "joint_damping", "d_star": 6.25}]}
    evidence = {"joint_damping": 7.0, "emg_drift": 3.0, "wrap_surface": 2.5}
    assert places_of_cause(truth, answer(evidence, {"joint_damping": 5.0})) == (3, 1)
    assert places_of_cause(truth, answer({"emg_drift": 1.0}, None)) == (None, None)
