"""Cases recorded again with the simulator's truth in place of one assumption."""

import filecmp
from functools import cache

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import COORDINATES, CYCLES, PHASES, lines
from validation.blind.plan import banks_of
from validation.diagnosis import ladder
from validation.diagnosis.ladder import STEPS, WORLD, Step, first_were_the_null_exact

#: Person with nothing amiss; without noise of EMG in the truth, envelopes would not differ.
TRUTH = {"person": "worlds_00", "causes": [], "emg_noise": 0.1}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Record one case with nothing given, twice, and with each assumption replaced."""
    out = tmp_path_factory.mktemp("ladder")
    (bank,) = banks_of("worlds", 40, WORLD)
    steps = {"nothing": Step(), "again": Step(), "paths": Step(paths=True), "emg": Step(emg=True)}
    # All have one name, which the files contain.
    found = {name: out / name / "case" for name in steps}
    with pytest.MonkeyPatch.context() as patch:
        # The same person in all, drawn once.
        patch.setattr(ladder, "person_of", cache(ladder.person_of))
        for name, step in steps.items():
            ladder._record(step, bank, 0, TRUTH, found[name])
    return found


def differing(one, other):
    files = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    return {file.name for file in files if not filecmp.cmp(one / file, other / file, shallow=False)}


def test_what_is_not_given_is_recorded_as_before(folders):
    assert differing(folders["nothing"], folders["again"]) == set()
    assert differing(folders["nothing"], folders["paths"]) == {"model.osim"}
    assert differing(folders["nothing"], folders["emg"]) == {"emg.sto"}


def test_steps_have_different_names():
    assert STEPS[0].name == "nothing"
    assert len({step.name for step in STEPS}) == len(STEPS)


def test_a_bank_without_the_world_is_refused_with_the_command_that_makes_it(tmp_path, monkeypatch, capsys):
    arguments = ["ladder", "--bank", str(tmp_path), "--out", str(tmp_path / "out")]
    monkeypatch.setattr("sys.argv", arguments)
    assert ladder.main() == 2
    assert f"--world {WORLD}" in capsys.readouterr().err


def test_a_signal_far_above_the_null_is_first_in_every_draw_and_without_one_chance_decides():
    shapes = np.random.default_rng(3).normal(size=(2, CYCLES, PHASES, COORDINATES))
    signatures = {"cause": shapes[0], "other": shapes[1]}

    def share(size, accepted):
        case = lines(shapes[0], signatures)
        return first_were_the_null_exact(case, size * shapes[0], accepted, case.linearized.candidates)

    assert share(5.0, {"cause"}) == 1.0 and share(5.0, {"other"}) == 0.0
    assert 0.2 < share(0.0, {"cause"}) < 0.8
