"""The left leg is the mirror image of the right one, and both are legs of one person."""

import re

import numpy as np
import opensim
import pytest

from wrapjax.datasets.virtual_person.anatomy import BODIES, COORDINATES
from wrapjax.datasets.virtual_person.gait import normative_cycle
from wrapjax.datasets.virtual_person.leg import MUSCLES, build_leg_model, mirrored, on_side
from wrapjax.datasets.virtual_person.true_parameters import draw_true_parameters, read_true_parameters
from wrapjax.datasets.virtual_person.virtual_subject import Series, write_virtual_legs, write_virtual_subject
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.osim.virtual_leg import Body, Joint, LegModel
from wrapjax.subject.subject import load_subject, read_legs

SERIES = (Series(0.8, 1, 0), Series(1.2, 0, 1))
NAMES = tuple(muscle.name for muscle in MUSCLES)


def on_left(names):
    return tuple(on_side(name, "l") for name in names)


@pytest.fixture(scope="module")
def left_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("left_leg") / "model.osim"
    build_leg_model(path, "l")
    return path


@pytest.fixture(scope="module")
def poses():
    cycle = normative_cycle()
    walking = cycle.angles(np.linspace(cycle.start, cycle.end, 41)).T
    return walking + np.random.default_rng(1).normal(0.0, 0.05, walking.shape)


def test_all_names_are_of_the_left_leg(left_file):
    text = left_file.read_text(encoding="utf-8")
    assert "soleus_l" in text
    assert not re.search(r"_r\b", text)
    assert not re.search(r"-0(?![.\d])", text), "a negative zero"


def test_out_of_plane_mass_centers_and_shifts_are_mirrored():
    """The virtual leg has none of these."""
    leg = LegModel(
        name="made_up",
        credits="",
        publications="",
        bodies=(Body("tibia_r", 1.0, (0.1, 0.2, 0.3), (1.0, 2.0, 3.0)),),
        joints=(
            Joint("knee_r", "femur_r", "tibia_r", (1.0, 2.0, 3.0), shift={"x": (1.0,), "z": (2.0, -1.0)}),
        ),
        cylinders=(),
        muscles=(),
    )
    found = mirrored(leg)
    assert found.bodies == (Body("tibia_l", 1.0, (0.1, 0.2, -0.3), (1.0, 2.0, 3.0)),)
    assert found.joints[0].location == (1.0, 2.0, -3.0)
    assert found.joints[0].shift == {"x": (1.0,), "z": (-2.0, 1.0)}


def test_same_lengths_and_moment_arms_at_the_same_angles(leg_file, left_file, poses):
    right = analyse_muscles(leg_file, NAMES, COORDINATES, poses, quiet=True, processes=1)
    left = analyse_muscles(left_file, on_left(NAMES), on_left(COORDINATES), poses, quiet=True, processes=1)
    np.testing.assert_allclose(left.length, right.length, rtol=0, atol=1e-9)
    np.testing.assert_allclose(left.moment_arm, right.moment_arm, rtol=0, atol=1e-9)


def test_same_angles_are_mirrored_poses(leg_file, left_file, poses):
    """Mass centers and a distant point of every segment, so that rotations count too."""

    def stations(file, side, values):
        model = opensim.Model(str(file))
        state = model.initSystem()
        for name, value in zip(COORDINATES, values, strict=True):
            model.getCoordinateSet().get(on_side(name, side)).setValue(state, float(value), False)
        model.realizePosition(state)
        found = []
        for body in BODIES:
            segment = model.getBodySet().get(on_side(body.name, side))
            sign = 1.0 if side == "r" else -1.0
            for point in (segment.get_mass_center(), opensim.Vec3(0.1, -0.2, 0.3 * sign)):
                found.append(segment.findStationLocationInGround(state, point).to_numpy())
        return np.array(found)

    for values in poses[::10]:
        right, left = stations(leg_file, "r", values), stations(left_file, "l", values)
        np.testing.assert_allclose(left, right * [1.0, 1.0, -1.0], rtol=0, atol=1e-12)


@pytest.fixture(scope="module")
def legs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("subjects") / "person"
    truths = write_virtual_legs(folder, seed=3, emg_noise=0.0, moment_noise=0.0, series=SERIES)
    return folder, truths


def test_the_folders_name_each_other(legs):
    folder, truths = legs
    for name, side in (("right", "r"), ("left", "l")):
        subject = load_subject(folder / name)
        assert subject.name == f"person_{name}" and subject.notes == () and subject.side == side
        assert subject.muscles.names == truths[name].muscles == read_true_parameters(folder / name).muscles
        assert [leg.side for leg in read_legs(subject)] == [side, "l" if side == "r" else "r"]


def test_lengths_are_shared_and_emg_scales_are_not(legs):
    right, left = legs[1]["right"], legs[1]["left"]
    assert left.muscles == on_left(right.muscles)
    for name in ("activation_time_constant", "activation_nonlinearity"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
    for name in ("optimal_fiber_length", "tendon_slack_length"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
    for name in ("electromechanical_delay", "emg_scale"):
        assert not np.any(getattr(left, name) == getattr(right, name))


def test_the_right_leg_is_that_of_the_single_subject(legs, clean_folder):
    """With the same seed only the leg's name and the other leg are different."""
    folder = legs[0] / "right"
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert names == {
        str(path.relative_to(clean_folder)) for path in clean_folder.rglob("*") if path.is_file()
    }
    changed = {name for name in names if (folder / name).read_bytes() != (clean_folder / name).read_bytes()}
    assert changed == {"subject.toml"}
    old, new = ((place / "subject.toml").read_text().splitlines() for place in (clean_folder, folder))
    assert set(new) - set(old) == {'name = "person_right"', 'other_leg = "../left"'}


def test_a_seed_always_gives_the_same_person(legs):
    """Also that of earlier versions with a single leg."""
    expected = draw_true_parameters(np.random.default_rng(np.random.SeedSequence(3).spawn(3)[0]))
    np.testing.assert_array_equal(legs[1]["right"].electromechanical_delay, expected.electromechanical_delay)


def test_the_left_leg_has_its_own_cycles(legs):
    right, left = (load_subject(legs[0] / name).trials for name in ("right", "left"))
    assert not np.any(right.angles[:, :, 10] == left.angles[:, :, 10])
    # It is as physiological as the right one.
    for place, name in enumerate(COORDINATES):
        peaks = [np.abs(trials.moments[:, place]).max() for trials in (right, left)]
        assert max(peaks) < 2.0 * min(peaks), name


def test_legs_are_written_completely_or_not_at_all(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError("disk full")

    monkeypatch.setattr("wrapjax.datasets.virtual_person.virtual_subject.settings_text", fail)
    for write in (write_virtual_legs, write_virtual_subject):
        with pytest.raises(OSError, match="disk full"):
            write(tmp_path / "person", series=(Series(1.2, 1, 0),))
        assert not list(tmp_path.iterdir())
