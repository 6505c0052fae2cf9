"""``wrapjax diagnose A --against B`` from two folders to the page: what differs is found, and where."""

import numpy as np
import pytest

from tests.cli.folders import names, read_json
from tests.cli.test_check import assert_only_errors
from tests.subject.synthetic import (
    CHANNELS,
    COORDINATES,
    PERIOD,
    RATE,
    angles,
    angular_velocities,
    emg,
    moments,
    write_subject,
)
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.io.storage import Storage, write_storage

#: Few effects, one start.
TESTED = {"joint_damping", "emg_offset", "curve_family", "muscle_attachment"}
QUICK = ("--starts", "1", "--without", *sorted(set(CATALOGUE) - TESTED))
CYCLES = 4
#: Damping of the knee by the brace, N m s/rad.
DAMPING = 4.0


def write_condition(folder, damping: float, seed: int) -> None:
    """Write four cycles with noise of their own, and a knee that a brace damps."""
    write_subject(folder)
    generator = np.random.default_rng(seed)
    time = np.arange(round((CYCLES + 1) * PERIOD * RATE) + 1) / RATE
    waves = np.sin(2.0 * np.pi * np.outer(np.arange(1, 16), time) / (time[-1]) + 1.0)
    noise = generator.normal(0.0, 0.5, (2, 15)) @ waves
    speed = angular_velocities(time)
    measured = moments(time) + noise
    measured[1] -= damping * speed[1]
    place = folder / "trials" / "walk_a"
    columns = tuple(f"{name}_moment" for name in COORDINATES)
    write_storage(place / "angles.sto", Storage("angles", COORDINATES, time, angles(time).T))
    write_storage(place / "moments.sto", Storage("moments", columns, time, measured.T))
    write_storage(place / "emg.sto", Storage("emg", tuple(CHANNELS), time, emg(time).T))
    cycles = ", ".join(
        f"[{0.3 + number * PERIOD:g}, {0.3 + (number + 1) * PERIOD:g}]" for number in range(CYCLES)
    )
    settings = folder / "subject.toml"
    text = settings.read_text().replace("cycles = [[0.5, 1.7], [1.7, 2.9]]", f"cycles = [{cycles}]")
    settings.write_text(text[: text.index('\n[[trial]]\nname = "walk_b"')])


@pytest.fixture(scope="module")
def conditions(tmp_path_factory):
    place = tmp_path_factory.mktemp("conditions")
    write_condition(place / "brace", DAMPING, 1)
    write_condition(place / "free", 0.0, 2)
    return place / "brace", place / "free"


@pytest.mark.slow
def test_a_brace_is_found_where_it_acts(run, conditions, tmp_path):
    brace, free = conditions
    out = tmp_path / "difference"
    done = run("diagnose", brace, "--against", free, *QUICK, "--out", out)
    assert done.status == 0, done.progress
    content = read_json(out / "difference.json")
    assert content["conditions"] == ["brace", "free"] and content["cycles"] == [CYCLES, CYCLES]
    assert content["outcome"] == "named"
    assert content["named"] == [{"id": "joint_damping", "condition": "brace"}]
    assert content["explained_share"] > 0.5
    assert content["where"][0]["coordinate"] == "knee_angle_l"
    # Muscles are attached to the same places in both conditions.
    untested = {one["id"]: one["reason"] for one in content["not_testable"]}
    assert "the same in both conditions" in untested["muscle_attachment"]
    assert "muscle_attachment" not in {one["id"] for one in content["effects"]}
    assert {"report.html", "settings.toml"} <= set(names(out))
    assert "joint_damping in 'brace'" in done.output


def test_conditions_of_two_people_are_refused(run, conditions, tmp_path):
    brace, _ = conditions
    other = tmp_path / "other"
    write_condition(other, 0.0, 3)
    settings = other / "subject.toml"
    settings.write_text(settings.read_text().replace("mass_kg = 70", "mass_kg = 95"))
    outcome = run("diagnose", brace, "--against", other, "--out", tmp_path / "difference")
    (line,) = assert_only_errors(outcome, "mass_kg")
    assert "95" in line and "70" in line and not (tmp_path / "difference").exists()


def test_a_condition_that_nobody_named_is_refused(run, conditions, tmp_path):
    outcome = run("diagnose", conditions[0], "--against", "barefoot", "--out", tmp_path / "difference")
    (line,) = assert_only_errors(outcome, "barefoot")
    assert "--against" in line
