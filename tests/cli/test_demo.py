"""``wrapjax demo``: calibration of a virtual person, reports, and comparison with the true parameters.

Methods that change muscle paths and the diagnosis take most of the demo's time and are tested elsewhere: they
are left out here except in one slow test.
"""

import json
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import wrapjax.cli.calibrate
import wrapjax.demonstration.demo
from tests.report.synthetic_diagnosis import named
from wrapjax.calibration.calibration import Calibration, calibrate
from wrapjax.calibration.solvers.augmented_lagrangian import LagrangianState
from wrapjax.calibration.solvers.interface import Iteration
from wrapjax.cli.calibrate import iteration_log
from wrapjax.cli.command_line import main
from wrapjax.datasets.virtual_person.hidden_effects import HIDDEN_EFFECTS
from wrapjax.datasets.virtual_person.virtual_subject import Series, write_virtual_subject
from wrapjax.demonstration.demo import EXCLUDED_EFFECTS, DiagnosisDemonstration, draw_effect
from wrapjax.demonstration.wrap_recovery import WrapRecovery
from wrapjax.path_sources.polynomial_fit import Fit

#: Walking of the virtual person: a third of the cycles that a demonstration has.
FEW = (Series(0.8, 1, 1), Series(1.2, 1, 0))


def simulated_diagnosis(folder, hidden, **options):
    """Return a prepared diagnosis; real ones are run by a notebook and by slow tests."""
    answer = object.__new__(DiagnosisDemonstration)
    object.__setattr__(answer, "hidden", hidden)
    object.__setattr__(answer, "diagnosis", SimpleNamespace(result=named()))
    return answer


def nga_for_pga():
    """Make a function that calibrates by NGA, and returns that calibration where PGA is asked for."""
    done = []

    def either(subject, method, paths, **options):
        if method == "NGA":
            done[:] = [calibrate(subject, method, paths, **options)]
        return done[0]

    return either


def unmoved_wraps(calibration, true_parameters, noise):
    """Return a recovery of one cylinder that stays where it is; the slow test has that of PGA."""
    arms, cylinder = np.zeros((1, 1, 1, 1)), np.zeros((1, 6))
    return WrapRecovery(
        ("soleus_r",), ("knee_angle_r",), arms, arms, arms, np.ones((1, 1)), ("cylinder",), cylinder, cylinder
    )


def interrupted_diagnosis(*arguments, **options):
    """Raise the interruption of a diagnosis."""
    raise KeyboardInterrupt


def without_motion(save):
    """Leave out the pages in motion, which take half a minute and are tested in tests/report."""
    return lambda result, folder, **options: save(result, folder, **{**options, "motion": False})


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """Run a demo by NGA, which stands for PGA, too, that is interrupted before its diagnosis, and resume it.

    Returns the exit statuses of the first run, of one without ``--resume``, and of one with it; the numbers
    of iterations of the first and the last; and the folder.
    """
    folder = tmp_path_factory.mktemp("demo") / "out"
    counts = []

    def counting(**options):
        counts.append(0)

        def count(*iteration):
            counts[-1] += 1

        return count

    words = ["demo", "--out", str(folder), "--seed", "3", "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            wrapjax.demonstration.demo, "write_virtual_subject", partial(write_virtual_subject, series=FEW)
        )
        for kind in (Fit, Calibration):
            patch.setattr(kind, "save", without_motion(kind.save))
        patch.setattr(wrapjax.demonstration.demo, "_STARTS", {"NGA": 1, "PGA": 1})
        patch.setattr(wrapjax.demonstration.demo, "calibrate", nga_for_pga())
        patch.setattr(wrapjax.demonstration.demo, "exact_geometry", lambda subject: None)
        patch.setattr(wrapjax.demonstration.demo, "wrap_recovery", unmoved_wraps)
        patch.setattr(wrapjax.cli.calibrate, "iteration_printer", counting)
        patch.setattr(wrapjax.demonstration.demo, "demonstrate_diagnosis", interrupted_diagnosis)
        statuses = [main(words), main(words)]
        patch.setattr(wrapjax.demonstration.demo, "demonstrate_diagnosis", simulated_diagnosis)
        statuses.append(main([*words, "--resume"]))
    return statuses, counts, folder


@pytest.fixture(scope="module")
def shown(interrupted):
    """Exit status and folder of a demo by NGA."""
    statuses, _, folder = interrupted
    return statuses[-1], folder


def test_finished_parts_are_not_repeated_after_an_interruption(interrupted):
    statuses, iterations, folder = interrupted
    assert statuses == [1, 2, 0]
    first, *_, last = iterations
    assert first > 20 and last == 0
    assert [place.name for place in folder.parent.iterdir()] == [folder.name], "nothing is left to go on from"


def test_everything_is_written_and_converged(shown):
    status, folder = shown
    assert status == 0
    summary = json.loads((folder / "NGA" / "summary.json").read_text())
    assert summary["converged"] and summary["mae_Nm"]["validation"]["mean"] < 4.0
    figures = ("recovery.png", "wrap_recovery.png")
    for file in (
        "virtual_subject/truth.json",
        "fit/fit.json",
        "NGA/report.html",
        "index.html",
        *figures,
    ):
        assert (folder / file).stat().st_size > 0, file


def test_iterations_go_to_a_log_where_nobody_watches(tmp_path):
    """A later start, or a resumed run, continues the file."""
    iteration = Iteration(
        number=0, cost=12.5, optimality=1e-3, damping=1e-4, step=0.0, at_bounds=2, seconds=0.1
    )
    state = object.__new__(LagrangianState)
    for start in (0, 1):
        iteration_log(tmp_path / "log")(start, iteration, state)
    head, first, _, second = (tmp_path / "log").read_text().splitlines()
    assert head.split()[:3] == ["start", "iteration", "cost"]
    assert first.split()[:3] == ["0", "0", "12.5"] and second.split()[0] == "1"


def test_calibration_reduces_the_error_of_emg_scales(shown):
    """EMG scales determine the strength of muscles and must improve. Other parameters need not."""
    content = json.loads((shown[1] / "demo.json").read_text())
    recovery = {row["parameter"]: row for row in content["recovery"]}
    assert recovery["emg_scale"]["median_error_after"] < 0.6 * recovery["emg_scale"]["median_error_before"]
    assert all(row["median_deviation"] > 0.0 for row in recovery.values())
    assert "not an accuracy" in content["note"]


def test_the_seed_determines_the_simulated_effect(shown):
    content = json.loads((shown[1] / "demo.json").read_text())["gap"]
    assert content["hidden"] == draw_effect(3) and content["outcome"] == "named"
    drawn = {draw_effect(seed) for seed in range(40)}
    assert drawn == set(HIDDEN_EFFECTS) - set(EXCLUDED_EFFECTS) and len(drawn) >= 5


def test_existing_folder_is_left_alone(shown, capsys):
    before = (shown[1] / "demo.json").read_bytes()
    assert main(["demo", "--out", str(shown[1])]) == 2
    assert "--force" in capsys.readouterr().err
    assert (shown[1] / "demo.json").read_bytes() == before


@pytest.mark.slow
def test_all_four_methods_are_shown(tmp_path):
    assert main(["demo", "--out", str(tmp_path / "out"), "--quiet"]) == 0
    methods = json.loads((tmp_path / "out" / "demo.json").read_text())["methods"]
    assert list(methods) == ["NGA", "SGA", "LSGA", "PGA"]
    errors = {name: method["mae_calibration_Nm"] for name, method in methods.items()}
    assert errors["NGA"] > max(errors["SGA"], errors["LSGA"], errors["PGA"])
    for name in (*methods, "gap"):
        assert (tmp_path / "out" / name / "report.html").stat().st_size > 0
    content = json.loads((tmp_path / "out" / "demo.json").read_text())
    # Standard deviations due to noise are reported, so that unidentifiable arms do not look recovered.
    true_parameters = json.loads((tmp_path / "out" / "virtual_subject" / "truth.json").read_text())
    found = content["wrap_recovery"]
    assert {name: wrap["true"] for name, wrap in found["wraps"].items()} == true_parameters["wraps"]
    assert all(wrap["found"] != wrap["true"] for wrap in found["wraps"].values())
    errors = found["moment_arm_error"]["knee_angle_r"]
    assert errors["before_m"] > 1e-4
    assert errors["open_m"] > 1e-3 and errors["told_apart"] == 0
    content = content["gap"]
    assert content["hidden"] in HIDDEN_EFFECTS and content["right"] and "no accuracy" in content["note"]
    assert "same-form data" in (tmp_path / "out" / "gap" / "report.html").read_text()
    for file in (tmp_path / "out" / "hidden_effect").rglob("*.toml"):
        assert content["hidden"] not in file.read_text()
