"""Left and right as one unknown: a symmetric person is recovered, one side alone is refused."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from tests.joints.person import make_person, mirrored, settings_text
from wrapjax.errors import InputError
from wrapjax.geometry.marker_model import build_marker_model
from wrapjax.joints.changed_skeleton import skeleton_change
from wrapjax.joints.personalisation import personalize_joints
from wrapjax.joints.problem import symmetric_unknowns
from wrapjax.joints.settings import JointSettings, MarkerTrial, read_joint_settings
from wrapjax.osim.model import describe_model


def test_one_unknown_changes_both_sides_as_in_a_mirror(tmp_path):
    """In a symmetric pose, markers of the changed left leg are the mirror image of those of the right one."""
    person = make_person(tmp_path, both_sides=True)
    description = describe_model(person.model)
    names = tuple(marker.name for marker in description.markers)
    coordinates = tuple(entry.name for entry in description.coordinates)
    model = build_marker_model(description, coordinates, names)
    combination = symmetric_unknowns(person.parameters, "joints.toml")
    assert combination.shape == (len(person.parameters), len(person.parameters) // 2)
    change = skeleton_change(description, model, names, person.parameters, combination)
    rng = np.random.default_rng(0)
    pose = np.zeros(len(coordinates))
    for column, name in enumerate(coordinates):
        if name.endswith("_r"):
            pose[column] = rng.normal(0.0, 0.5)
            # Flexion is alike in a mirror; the axes of adduction and rotation turn the other way round.
            same = "adduction" not in name and "rotation" not in name
            pose[coordinates.index(name[:-2] + "_l")] = pose[column] if same else -pose[column]
    posed, placed = jnp.asarray(pose), eqx.filter_jit(lambda skeleton, at: skeleton.positions(at))
    changed = change.apply(model, rng.normal(0.0, 0.05, combination.shape[1]))
    for skeleton in (model, changed):
        positions = dict(zip(names, np.asarray(placed(skeleton, posed)), strict=True))
        for name in (name for name in names if name.endswith("_r") and not name.startswith("PEL")):
            mirrored_place = positions[name[:-2] + "_l"] * [1.0, 1.0, -1.0]
            np.testing.assert_allclose(positions[name], mirrored_place, atol=1e-12)
    moved = np.asarray(placed(changed, posed)) - np.asarray(placed(model, posed))
    assert np.abs(moved).max() > 0.02


@pytest.mark.slow
def test_a_symmetric_person_is_recovered_from_half_the_unknowns(tmp_path):
    """The left joints are found where OpenSim has them, though only the right ones are unknown."""
    person = make_person(tmp_path, both_sides=True)
    settings = JointSettings(
        file=tmp_path / "joints.toml",
        name="P",
        model_file=person.model,
        trials=(MarkerTrial("walk", tmp_path / "walk.trc"),),
        parameters=person.parameters,
        prior_factor=1e3,
        skin_movement=0.0,
        symmetric=True,
        frames=30,
    )
    found = personalize_joints(settings)
    half = len(person.parameters) // 2
    _, signs = mirrored(person.parameters[:half])
    np.testing.assert_allclose(found.values[half:], signs * found.values[:half], atol=1e-12)
    np.testing.assert_allclose(found.posterior.sd[half:], found.posterior.sd[:half])
    truth = {joint.name: joint for joint in describe_model(person.true_model).joints}
    for joint in found.after.joints:
        if joint.name in ("hip_r", "hip_l"):
            np.testing.assert_allclose(
                joint.in_parent.translation, truth[joint.name].in_parent.translation, atol=1e-5
            )
    assert found.rms["after"] < 1e-6 and found.rms["before"] > 0.005


def test_a_freed_joint_of_one_side_alone_is_refused(tmp_path):
    person = make_person(tmp_path)
    with pytest.raises(InputError, match="symmetric sides need 'hip_l' freed as 'hip_r' is"):
        symmetric_unknowns(person.parameters, "joints.toml")


def test_nothing_with_two_sides_is_refused(tmp_path):
    person = make_person(tmp_path)
    scale = replace(person.parameters[0], kind="scale", owner="pelvis", axis=-1)
    with pytest.raises(InputError, match="expected freed joints of both sides"):
        symmetric_unknowns([scale], "joints.toml")


def test_settings_say_symmetric(tmp_path):
    make_person(tmp_path)
    (tmp_path / "joints.toml").write_text(settings_text("symmetric = true\n"))
    assert read_joint_settings(tmp_path).symmetric
