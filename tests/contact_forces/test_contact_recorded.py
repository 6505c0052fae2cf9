"""Hip contact forces of a healthy walker are in the published range; OpenSim and the engine agree."""

import numpy as np
import pytest

import wrapjax
from wrapjax.contact_forces.contact_force import (
    _joint_reactions,
    _joints,
    contact,
    lines_of_action,
    sum_muscle_forces,
)
from wrapjax.contact_forces.contact_result import JOINT_REACTION, peak_windows, peaks
from wrapjax.diagnosis.inputs.read_movement import read_recorded_movement
from wrapjax.evaluation.stored_run import read_curves
from wrapjax.geometry.exact_paths.engine import PARITY
from wrapjax.osim.model import describe_model


@pytest.fixture(scope="module")
def runs(data_folder, tmp_path_factory):
    """Runs by NGA and PGA with exact paths."""
    subject = wrapjax.load_subject(data_folder / "healthy_overground")
    place = tmp_path_factory.mktemp("runs")
    for method in ("NGA", "PGA"):
        wrapjax.calibrate(subject, method, wrapjax.exact_geometry(subject), starts=1).save(place / method)
    return place / "NGA", place / "PGA"


@pytest.fixture(scope="module")
def run(runs):
    return runs[0]


@pytest.mark.slow
def test_hip_forces_are_two_to_six_bodyweights(run):
    result = contact(run).result
    assert result.kind == JOINT_REACTION
    hip = result.runs[0].magnitude[0, list(result.joints).index("hip")] / result.bodyweight
    assert 2.0 < hip[:60].max() < 6.0  # In stance.
    assert hip[65:].max() < 0.6 * hip[:60].max()  # Less in swing.
    # The largest component is upward on the pelvis.
    assert np.abs(result.runs[0].force[0, 0, 1]).max() > 0.9 * hip.max() * result.bodyweight


@pytest.mark.slow
def test_the_first_peak_is_early_in_stance(runs):
    """As in studies with instrumented hips, on the nominal and on the personalised model."""
    result = contact(*runs).result
    assert [own.label for own in result.runs] == ["NGA", "PGA"]
    assert not np.array_equal(result.runs[0].force, result.runs[1].force)
    # The peak is not at an end of its window.
    low, high = peak_windows("hip")["first_peak"]
    for own in result.runs:
        first = peaks(result.curves(own, "hip"), result.phase, (low, high))
        assert low < first.phase[0] < high
        assert 2.0 < first.force[0] / result.bodyweight < 6.0
        near = np.abs(result.phase[0] - first.phase[0]) < 3.0
        assert result.curves(own, "hip")[0, near].max() == first.force[0]


@pytest.mark.slow
def test_lines_of_action_agree_with_opensim(run):
    """With OpenSim's wrapping, the line of action of every muscle is OpenSim's."""
    read = read_curves(run)
    subject, model = read.subject, describe_model(read.subject.model_file)
    joints = tuple(_joints(subject.model_file, subject.trials.moment_coordinates).values())
    walk, _ = read_recorded_movement(subject)
    question = (walk, subject.model_file, joints, read.run.muscles)
    (with_muscles, _), (without, _) = (
        _joint_reactions(*question, force) for force in (read.force, 0.0 * read.force)
    )
    spanned = {name for muscle in read.run.muscles for name in model.spanned_by(muscle)}
    coordinates = [name for name in subject.trials.coordinates if name in spanned]
    angles = subject.trials.angles[:, [subject.trials.coordinates.index(name) for name in coordinates]]
    lines = lines_of_action(model, read.run.muscles, joints, coordinates, angles, PARITY)
    np.testing.assert_allclose(sum_muscle_forces(lines, read.force), with_muscles - without, atol=1e-3)
