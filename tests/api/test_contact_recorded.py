"""Defends: a healthy walker's hip bears what hips of walkers bear, and OpenSim and the engine agree on it."""

import numpy as np
import pytest

import wrapjax
from wrapjax.api.runs.contact_force import _joints, _reactions, contact
from wrapjax.api.runs.run_curves import read_curves
from wrapjax.contact.lines_of_action import lines_of_action, muscle_share
from wrapjax.contact.result import JOINT_REACTION
from wrapjax.geometry.engine import PARITY
from wrapjax.measurement.changes import recorded_walk
from wrapjax.osim import describe_model


@pytest.fixture(scope="module")
def run(data_folder, tmp_path_factory):
    subject = wrapjax.load_subject(data_folder / "healthy_overground")
    folder = tmp_path_factory.mktemp("runs") / "nga"
    wrapjax.calibrate(subject, "NGA", wrapjax.exact_geometry(subject), starts=1).save(folder)
    return folder


@pytest.mark.slow
def test_a_walkers_hip_bears_two_to_six_bodyweights(run):
    result = contact(run).result
    assert result.kind == JOINT_REACTION
    hip = result.runs[0].magnitude[0, list(result.joints).index("hip")] / result.bodyweight
    assert 2.0 < hip[:60].max() < 6.0  # while the foot is on the ground
    assert hip[65:].max() < 0.6 * hip[:60].max()  # and less while it swings
    # Above all it presses up, on the pelvis.
    assert np.abs(result.runs[0].force[0, 0, 1]).max() > 0.9 * hip.max() * result.bodyweight


@pytest.mark.slow
def test_muscles_press_in_opensim_as_the_engine_says(run):
    """Wrapped as OpenSim wraps, every muscle's line is OpenSim's."""
    read = read_curves(run)
    subject, model = read.subject, describe_model(read.subject.model_file)
    joints = tuple(_joints(subject.model_file, subject.trials.moment_coordinates).values())
    walk, _ = recorded_walk(subject)
    question = (walk, subject.model_file, joints, read.run.muscles)
    (with_muscles, _), (without, _) = (
        _reactions(*question, force) for force in (read.force, 0.0 * read.force)
    )
    spanned = {name for muscle in read.run.muscles for name in model.spanned_by(muscle)}
    coordinates = [name for name in subject.trials.coordinates if name in spanned]
    angles = subject.trials.angles[:, [subject.trials.coordinates.index(name) for name in coordinates]]
    lines = lines_of_action(model, read.run.muscles, joints, coordinates, angles, PARITY)
    np.testing.assert_allclose(muscle_share(lines, read.force), with_muscles - without, atol=1e-3)
