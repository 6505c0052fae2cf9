"""Diagnosis of a bank: reuse of answers, failures of single cases, baselines and withheld causes."""

import json
import pickle
import types
from pathlib import Path

import pytest

import wrapjax
from validation.diagnosis import case_answers, diagnose_bank
from wrapjax.cohorts.scheduling import Finished
from wrapjax.errors import InputError, Problem


@pytest.fixture
def diagnosed(monkeypatch):
    """Record diagnosed cases and their withheld effects; diagnosis of the case 'bad' fails."""
    seen = []

    def diagnose(subject, method, paths, *, starts):
        if subject.name == "bad":
            raise ValueError("no such muscle")
        return answered(subject)

    def answered(subject, *withheld):
        seen.append((subject.name, withheld))
        result = types.SimpleNamespace(outcome="named", named=("joint_damping",), ties=(), linearized=None)

        def without(*effects):
            answer = subject.parent.parent / "answers" / subject.name / "question.json"
            assert answer.exists(), "the truth is read only after the answer is written"
            return answered(subject, *effects)

        return types.SimpleNamespace(
            result=result, without=without, save=lambda folder: (folder / "moments").mkdir(parents=True)
        )

    monkeypatch.setattr(wrapjax, "load_subject", lambda case: case)
    monkeypatch.setattr(wrapjax, "fit", lambda subject, geometry, processes: None)
    monkeypatch.setattr(wrapjax, "diagnose", diagnose)
    monkeypatch.setattr(case_answers, "set_up_jax", lambda: None)
    return seen


def bank(folder, *names):
    for name in names:
        (folder / "cases" / name).mkdir(parents=True)
        (folder / "cases" / name / "subject.toml").write_text(f"# {name}\n")
    return folder


def answer(monkeypatch, folder, *more):
    arguments = ["diagnose_bank", "--bank", str(folder), "--out", str(folder / "answers"), *more]
    monkeypatch.setattr("sys.argv", arguments)
    return diagnose_bank.main()


def test_case_is_diagnosed_again_only_if_its_inputs_changed(diagnosed, monkeypatch, tmp_path, capsys):
    folder = bank(tmp_path, "one", "two")
    assert answer(monkeypatch, folder) == 0
    assert answer(monkeypatch, folder) == 0
    assert [name for name, _ in diagnosed] == ["one", "two"]
    assert capsys.readouterr().err.count("unchanged") == 2
    (folder / "cases" / "two" / "subject.toml").write_text("# another two\n")
    assert answer(monkeypatch, folder) == 0
    assert [name for name, _ in diagnosed] == ["one", "two", "two"]


def test_failed_case_is_reported_and_others_continue(diagnosed, monkeypatch, tmp_path, capsys):
    folder = bank(tmp_path, "bad", "one")
    assert answer(monkeypatch, folder) == 1
    assert "bad: FAILED: ValueError: no such muscle" in capsys.readouterr().err
    assert (folder / "answers" / "one" / "question.json").exists()
    assert not (folder / "answers" / "bad" / "question.json").exists()


def test_single_causes_are_withheld_after_the_answer(diagnosed, monkeypatch, tmp_path):
    folder = bank(tmp_path, "one", "pair", "strange")
    (folder / "truth").mkdir()
    known = {
        "one": ("single", ["cop_offset"]),
        "pair": ("pair", ["cop_offset", "emg_drift"]),
        "strange": ("outside", ["electrode_dropout"]),
    }
    for name, (tier, causes) in known.items():
        truth = {"tier": tier, "causes": [{"id": cause} for cause in causes]}
        (folder / "truth" / f"{name}.json").write_text(json.dumps(truth))
    for _ in range(2):
        assert answer(monkeypatch, folder, "--withheld", str(folder / "withheld")) == 0
        assert diagnosed == [("one", ()), ("one", ("cop_offset",)), ("pair", ()), ("strange", ())]
    assert [path.name for path in (folder / "withheld").iterdir()] == ["one"]


def test_first_cases_are_selected_by_id(diagnosed, monkeypatch, tmp_path):
    assert answer(monkeypatch, bank(tmp_path, "c", "a", "b"), "--first", "2") == 0
    assert [name for name, _ in diagnosed] == ["a", "b"]


def test_withheld_causes_can_be_added_later(diagnosed, monkeypatch, tmp_path):
    folder = bank(tmp_path, "one")
    (folder / "truth").mkdir()
    (folder / "truth" / "one.json").write_text('{"tier": "single", "causes": [{"id": "cop_offset"}]}')
    assert answer(monkeypatch, folder) == 0
    assert answer(monkeypatch, folder, "--withheld", str(folder / "withheld")) == 0
    assert diagnosed[-1] == ("one", ("cop_offset",))
    assert (folder / "withheld" / "one" / "question.json").exists()


def test_baselines_can_be_added_later(diagnosed, monkeypatch, tmp_path):
    folder = bank(tmp_path, "one")
    assert answer(monkeypatch, folder) == 0
    (folder / "answers" / "one" / "untouched").write_text("an existing answer is not written again")
    assert answer(monkeypatch, folder, "--baselines", str(folder / "others")) == 0
    assert (folder / "answers" / "one" / "untouched").exists()
    found = sorted(path.relative_to(folder / "others").as_posix() for path in folder.rglob("gap.json"))
    assert found == [
        f"{name}/one/gap.json" for name in ("held_out_drop", "modification_index", "raw_correlation")
    ]


def test_ablations_are_answered(diagnosed, monkeypatch, tmp_path):
    folder = bank(tmp_path, "one")
    assert answer(monkeypatch, folder, "--ablations", str(folder / "others")) == 0
    found = {path.parent.parent.name for path in (folder / "others").rglob("gap.json")}
    assert {"score_alone", "without_input_errors", "without_muscle_errors", "without_repeated"} < found


def test_caches_are_cleared_after_every_case(diagnosed, monkeypatch, tmp_path):
    cleared = []
    monkeypatch.setattr(case_answers, "clear_caches_near_map_limit", lambda: cleared.append(True))
    assert answer(monkeypatch, bank(tmp_path, "bad", "one"), "--workers", "1") == 1
    assert len(cleared) == 2


@pytest.mark.parametrize("more", [("--workers", "3"), ("--scheduler", "tcp://host:8786")])
def test_workers_run_jobs_of_a_cohort(more, diagnosed, monkeypatch, tmp_path, capsys):
    """Check that jobs can be pickled and do not depend on the working folder."""
    called = []

    def run_jobs(work, jobs, *, scheduler, workers):
        called.append((scheduler, workers))
        for name, job in pickle.loads(pickle.dumps(jobs)).items():
            yield (
                Finished(name, None, "its worker process died")
                if name == "bad"
                else Finished(name, work(job))
            )

    monkeypatch.setattr(diagnose_bank, "run_jobs", run_jobs)
    monkeypatch.chdir(bank(tmp_path, "bad", "one"))
    assert answer(monkeypatch, Path("."), *more) == 1
    assert called == [(more[1] if more[0] == "--scheduler" else None, 3 if more[0] == "--workers" else 1)]
    assert "bad: FAILED: its worker process died" in capsys.readouterr().err
    assert (tmp_path / "answers" / "one" / "question.json").exists()


def test_missing_scheduler_is_an_input_error(diagnosed, monkeypatch, tmp_path, capsys):
    def no_scheduler(*given, **more):
        raise InputError(Problem("tcp://host:8786", "no dask scheduler answers there"))
        yield

    monkeypatch.setattr(diagnose_bank, "run_jobs", no_scheduler)
    assert answer(monkeypatch, bank(tmp_path, "one"), "--scheduler", "tcp://host:8786") == 2
    assert "no dask scheduler answers there" in capsys.readouterr().err
