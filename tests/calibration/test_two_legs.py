"""Joint calibration of two legs: shared parameters, one run folder, resumption and invalid folders."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.subject.synthetic import write_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.two_legs import SHARED
from wrapjax.cli.command_line import main
from wrapjax.datasets.virtual_person.virtual_subject import Series, write_virtual_legs
from wrapjax.errors import InputError
from wrapjax.subject.subject import load_subject as load_subject


def write_right_leg(folder):
    """Write the same leg for the other side, with larger moments."""
    write_subject(folder)
    for file in folder.rglob("*.*"):
        text = re.sub(r"_l(?=\b|_|-)", "_r", file.read_text(encoding="utf-8"))
        text = text.replace('side = "l"', 'side = "r"')
        file.write_text(text.replace("ActivationGroupL", "ActivationGroupR"), encoding="utf-8")
    scale_moments(folder, 1.3)
    return folder


def scale_moments(folder, factor):
    for file in folder.rglob("moments.sto"):
        head, table = file.read_text(encoding="utf-8").split("endheader\n")
        columns, *rows = table.splitlines()
        numbers = [row.split() for row in rows]
        scaled = ["\t".join([time, *(str(factor * float(one)) for one in rest)]) for time, *rest in numbers]
        file.write_text(head + "endheader\n" + "\n".join([columns, *scaled]) + "\n", encoding="utf-8")


def replace_text(file, old, new):
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")


def name_other_leg(folder, other):
    settings = folder / "subject.toml"
    text = settings.read_text(encoding="utf-8")
    settings.write_text(text.replace("[model]", f'other_leg = "{other}"\n\n[model]', 1), encoding="utf-8")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    left = write_subject(tmp_path_factory.mktemp("person") / "left")
    right = write_right_leg(left.parent / "right")
    name_other_leg(left, "../right")
    # The other leg may refer back.
    name_other_leg(right, "../left")
    return left, right


@pytest.fixture(scope="module")
def both(folders):
    return calibrate(load_subject(folders[0]), "NGA", starts=1)


def test_legs_share_the_listed_parameters(both):
    left, right = both.result, both.other_leg.result
    assert both.status.converged and right.muscles == ("recfem_r", "semiten_r")
    for name in SHARED:
        ours, theirs = (
            np.asarray(getattr(result.parameters, name)) / np.asarray(getattr(result.initial, name))
            for result in (left, right)
        )
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, err_msg=name)
    # Separate parameters account for the larger moments of the right leg.
    assert not np.allclose(left.parameters.emg_scale, right.parameters.emg_scale, rtol=1e-3)


def test_uncertainty_of_shared_parameters_is_shared(both):
    from wrapjax.calibration.uncertainty.uncertainty import uncertainty

    judged = uncertainty(both, "laplace", draws=200)
    assert len(judged.spreads) == 2
    left, right = (spread.parameters for spread in judged.spreads)
    for row, label in enumerate(left.labels):
        name = label.rsplit(".", 1)[1]
        other = right.labels.index(label.replace("_l.", "_r."))
        # Lengths are shared as ratios to the model's.
        sizes = (left.value[row], right.value[other]) if name.endswith("length") else (1.0, 1.0)
        if name in SHARED:
            assert left.deviation[row] / sizes[0] == pytest.approx(right.deviation[other] / sizes[1]), label
    for leg, spread in zip(both.legs, judged.spreads, strict=True):
        assert spread.low.shape == leg.result.modelled.shape
        assert (spread.low <= leg.result.modelled).mean() > 0.9


def test_one_run_folder_has_both_legs(folders, tmp_path):
    run = tmp_path / "run"
    words = ["calibrate", str(folders[0]), "--method", "NGA", "--out", str(run), "--starts", "2", "--quiet"]
    assert main(words) == 0
    first, second = (json.loads((place / "summary.json").read_text()) for place in (run, run / "other_leg"))
    assert first["converged"] and second["converged"] and first["starts"] == second["starts"] == 2
    assert "hip_flexion_l" in first["mae_Nm"]["calibration"]
    assert "hip_flexion_r" in second["mae_Nm"]["calibration"]
    files = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    own = {name for name in files if not name.startswith("other_leg/")} - {"settings.toml"}
    assert "settings.toml" in files
    assert {name.removeprefix("other_leg/") for name in files if name.startswith("other_leg/")} == own
    assert {"report.html", "parameters.csv", "starts.csv", "settings.json"} < own
    sides = [
        json.loads((place / "settings.json").read_text())["subject"] for place in (run, run / "other_leg")
    ]
    assert [Path(side["other_leg"]).name for side in sides] == ["right", "left"]
    assert not list(tmp_path.glob(".*"))


def stop(start, iteration, state):
    """Interrupt after the first step."""
    if iteration.number:
        raise KeyboardInterrupt


def test_one_leg_can_be_calibrated_alone(folders, both):
    alone = calibrate(replace(load_subject(folders[0]), other_leg=None), "NGA", starts=1)
    assert alone.other_leg is None and alone.status.converged
    # Without shared parameters the fit is better.
    assert alone.result.solution.cost < both.result.solution.cost


@pytest.mark.slow
def test_an_interrupted_first_stage_returns_both_legs(folders):
    done = calibrate(load_subject(folders[0]), "SGA", starts=1, callback=stop)
    assert done.status is Status.interrupted
    for leg in done.legs:
        assert np.isfinite(leg.result.modelled).all()
        assert not any("path_changes" in label for label in leg.result.labels)


def no_calibration_trial(folder):
    replace_text(folder / "subject.toml", 'use = "calibration"', 'use = "validation"')


def same_side(folder):
    shutil.rmtree(folder)
    write_subject(folder)


def points_elsewhere(folder):
    write_subject(folder.parent / "stranger")
    name_other_leg(folder, "../stranger")


def other_muscles(folder):
    for name in ("model.osim", "subject.toml"):
        replace_text(folder / name, "recfem_r", "recfemoris_r")
        replace_text(folder / name, "semiten_r", "semitendinosus_r")


BROKEN = {
    "same side": (same_side, ["left/subject.toml: [subject] other_leg", "same side 'l'"]),
    "points elsewhere": (points_elsewhere, ["right/subject.toml: [subject] other_leg", "stranger"]),
    "no calibration trial": (no_calibration_trial, ["right/subject.toml: no trial is marked use"]),
    "nothing to share": (other_muscles, ["left/subject.toml: [subject] other_leg", "share no parameter"]),
    "all at once": (
        lambda folder: (same_side(folder), points_elsewhere(folder)),
        ["same side", "stranger"],
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_incompatible_legs_are_refused(case, tmp_path, capsys):
    left = write_subject(tmp_path / "left")
    right = write_right_leg(tmp_path / "right")
    name_other_leg(left, "../right")
    spoil, words = BROKEN[case]
    spoil(right)
    run = tmp_path / "run"
    assert main(["calibrate", str(left), "--method", "NGA", "--out", str(run), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in words), said
    assert not run.exists()
    with pytest.raises(InputError):
        calibrate(load_subject(left), "NGA", starts=1)


def test_checkpoints_depend_on_the_other_leg(folders, tmp_path):
    """Changed recordings of the right leg give another fingerprint."""
    left, right = (shutil.copytree(folder, tmp_path / folder.name) for folder in folders)

    book = tmp_path / "journal"
    stopped = calibrate(load_subject(left), "NGA", starts=1, callback=stop, checkpoints=book)
    assert stopped.status is Status.interrupted
    resumed = calibrate(load_subject(left), "NGA", starts=1, checkpoints=book, resume=True)
    assert resumed.status.converged
    replace_text(right / "subject.toml", "mass_kg", "# heavier\nmass_kg")
    scale_moments(right, 1.1)
    with pytest.raises(InputError, match="other data or settings"):
        calibrate(load_subject(left), "NGA", starts=1, checkpoints=book, resume=True)


def test_a_broken_other_leg_is_named(tmp_path, capsys):
    left = write_subject(tmp_path / "left")
    right = write_right_leg(tmp_path / "right")
    name_other_leg(left, "../right")
    (right / "trials" / "walk_a" / "emg.sto").write_bytes(b"\x00\xff rubbish")
    assert main(["calibrate", str(left), "--method", "NGA", "--out", str(tmp_path / "run"), "--quiet"]) == 2
    assert "walk_a/emg.sto" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_custom_freedom_is_for_one_leg(folders):
    from wrapjax.model.freedom import nga_freedom
    from wrapjax.path_sources.model_inputs import model_parameters

    subject = load_subject(folders[0])
    with pytest.raises(ValueError, match="one leg"):
        calibrate(subject, freedom=nga_freedom(model_parameters(subject)), starts=1)


@pytest.fixture(scope="module")
def virtual_person(tmp_path_factory):
    """Virtual subject, one noisy cycle per speed: true parameters, joint and separate calibrations."""
    folder = tmp_path_factory.mktemp("virtual") / "person"
    truth = write_virtual_legs(folder, seed=0, series=(Series(0.8, 1, 0), Series(1.2, 1, 0)))
    legs = [load_subject(folder / name) for name in ("right", "left")]
    together = calibrate(legs[0], "NGA", starts=1)
    alone = [calibrate(replace(leg, other_leg=None), "NGA", starts=1) for leg in legs]
    return truth["right"], together, alone


@pytest.mark.slow
def test_both_legs_of_a_virtual_subject_are_calibrated(virtual_person):
    _, together, alone = virtual_person
    assert together.status.converged and all(leg.status.converged for leg in alone)
    for leg, single in zip(together.legs, alone, strict=True):
        assert leg.result.muscles == single.result.muscles
        error, best, before = (
            np.abs(modelled - leg.result.measured).mean()
            for modelled in (leg.result.modelled, single.result.modelled, leg.result.initial_modelled)
        )
        # Sharing costs little where there is a person to share.
        assert error < 1.1 * best < 0.5 * before


@pytest.mark.slow
def test_shared_parameters_are_at_least_as_accurate_as_separate_ones(virtual_person):
    """On average over parameters. The data are generated by the same model: a unit test, not an accuracy."""
    truth, together, alone = virtual_person

    def error(result, name):
        start, found, true = (getattr(tree, name) for tree in (result.initial, result.parameters, truth))
        return np.sqrt(np.mean(((np.asarray(found) - true) / np.maximum(start, 0.05)) ** 2))

    for name in SHARED:
        single = [error(leg.result, name) for leg in alone]
        found = [error(leg.result, name) for leg in together.legs]
        assert found[0] == pytest.approx(found[1], rel=1e-9), name
        assert found[0] <= np.mean(single), name
