"""Two legs of one person: what is the person's is shared, what is a leg's is not, and one run holds both."""

import json
import re

import numpy as np
import pytest

from tests.subject.synthetic import write_subject
from wrapjax.api import calibrate, load_subject
from wrapjax.calibrate.legs import SHARED
from wrapjax.cli import main
from wrapjax.errors import InputError


def write_right_leg(folder):
    """The same leg on the other side; it walks with stronger moments."""
    write_subject(folder)
    for file in folder.rglob("*.*"):
        text = re.sub(r"_l(?=\b|_|-)", "_r", file.read_text(encoding="utf-8"))
        text = text.replace('side = "l"', 'side = "r"')
        file.write_text(text.replace("ActivationGroupL", "ActivationGroupR"), encoding="utf-8")
    for file in folder.rglob("moments.sto"):
        head, table = file.read_text(encoding="utf-8").split("endheader\n")
        columns, *rows = table.splitlines()
        numbers = [row.split() for row in rows]
        stronger = ["\t".join([time, *(str(1.3 * float(one)) for one in rest)]) for time, *rest in numbers]
        file.write_text(head + "endheader\n" + "\n".join([columns, *stronger]) + "\n", encoding="utf-8")
    return folder


def name_other_leg(folder, other):
    settings = folder / "subject.toml"
    text = settings.read_text(encoding="utf-8")
    settings.write_text(text.replace("[model]", f'other_leg = "{other}"\n\n[model]', 1), encoding="utf-8")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    left = write_subject(tmp_path_factory.mktemp("person") / "left")
    right = write_right_leg(left.parent / "right")
    name_other_leg(left, "../right")
    # It may point back.
    name_other_leg(right, "../left")
    return left, right


@pytest.fixture(scope="module")
def both(folders):
    return calibrate(load_subject(folders[0]), "NGA", starts=1)


def test_legs_share_what_is_the_persons(both):
    left, right = both.result, both.other_leg.result
    assert both.status.converged and right.muscles == ("recfem_r", "semiten_r")
    for name in SHARED:
        ours, theirs = (
            np.asarray(getattr(result.parameters, name)) / np.asarray(getattr(result.initial, name))
            for result in (left, right)
        )
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, err_msg=name)
    # The right leg's moments are larger: something of its own must make up for them.
    assert not np.allclose(left.parameters.emg_scale, right.parameters.emg_scale, rtol=1e-3)


def test_one_run_holds_both_legs(folders, tmp_path):
    run = tmp_path / "run"
    words = ["calibrate", str(folders[0]), "--method", "NGA", "--out", str(run), "--starts", "2", "--quiet"]
    assert main(words) == 0
    first, second = (json.loads((place / "summary.json").read_text()) for place in (run, run / "other_leg"))
    assert first["converged"] and second["converged"] and first["starts"] == second["starts"] == 2
    assert "hip_flexion_l" in first["mae_Nm"]["calibration"]
    assert "hip_flexion_r" in second["mae_Nm"]["calibration"]
    assert (run / "other_leg" / "report.html").stat().st_size > 0
    assert not list(tmp_path.glob(".*"))


def test_a_leg_of_the_same_side_is_refused(tmp_path):
    left = write_subject(tmp_path / "left")
    write_subject(tmp_path / "again")
    name_other_leg(left, "../again")
    with pytest.raises(InputError, match="same side"):
        calibrate(load_subject(left), "NGA", starts=1)


def test_a_broken_other_leg_is_named(tmp_path, capsys):
    left = write_subject(tmp_path / "left")
    right = write_right_leg(tmp_path / "right")
    name_other_leg(left, "../right")
    (right / "trials" / "walk_a" / "emg.sto").write_bytes(b"\x00\xff rubbish")
    assert main(["calibrate", str(left), "--method", "NGA", "--out", str(tmp_path / "run"), "--quiet"]) == 2
    assert "walk_a/emg.sto" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_freedom_of_ones_own_is_for_one_leg(folders):
    from wrapjax.api.assembly import model_parameters
    from wrapjax.model import nga

    subject = load_subject(folders[0])
    with pytest.raises(ValueError, match="one leg"):
        calibrate(subject, freedom=nga(model_parameters(subject)), starts=1)
