"""Simulated persons with displaced wraps, and the evaluation of their moment arms."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from validation.blind import gait
from validation.blind.anatomy import COORDINATES, Cylinder, reference_leg
from validation.blind.dynamometer import ISOMETRIC, PASSIVE, RESISTANCE, perform
from validation.blind.hidden_wraps import (
    MOST,
    PLACE,
    RADIUS,
    TURN,
    at_frames,
    axis_of,
    clearance,
    write_hidden,
)
from validation.blind.hidden_wraps import hidden_wraps as simulate
from validation.blind.muscles import muscle_forces
from validation.blind.opensim_leg import muscle_paths
from validation.blind.worlds import GaitSettings, WorldSettings
from validation.calibration import hidden_wraps
from validation.calibration.hidden_wraps import (
    Question,
    arm_errors,
    decrease,
    evaluate_all,
    identifiable_and_touched,
    lines,
    summary,
    with_prior,
)
from validation.calibration.wrap_bounds import MOMENT_NOISE, bound_of_distance, distance_to_truth
from wrapjax.calibration.objective import MOMENT_ERROR
from wrapjax.calibration.sample_weights import samples_by_recording
from wrapjax.path_sources.exact import freed_wraps
from wrapjax.subject.subject import load_subject

WRAPPED = ("iliacus_r", "psoas_r", "recfem_r", "vasmed_r", "vaslat_r", "gasmed_r", "gaslat_r")


@pytest.fixture(scope="module")
def hidden():
    """Simulate a person with a short walk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gait, "DURATION", 4.0)
        short = GaitSettings(speeds=((1.1, 1.2),) * len(GaitSettings().speeds))
        patch.setattr(
            "validation.blind.hidden_wraps.default_world", lambda name: WorldSettings(name, name, gait=short)
        )
        yield simulate(3)


@pytest.fixture(scope="module")
def folder(hidden, tmp_path_factory):
    place = tmp_path_factory.mktemp("people") / "one"
    write_hidden(hidden, 3, 0.1, place)
    return place


def test_cylinders_are_displaced_within_limits_and_other_muscles_unchanged(hidden):
    before, after = hidden.who.world, hidden.world
    for own, true in zip(before.leg.cylinders, after.leg.cylinders, strict=True):
        away = (np.array(true.translation) - own.translation) / PLACE
        assert 0.1 < np.abs(away).max() <= MOST + 1e-9
        assert 0.0 < np.abs(true.rotation).max() <= MOST * TURN + 1e-9
        assert abs(true.radius / own.radius - 1.0) <= MOST * RADIUS + 1e-9
        assert clearance(after.leg, true) > 0.0
    assert after.leg.muscles == before.leg.muscles
    others = [name not in WRAPPED for name in after.leg.names]
    assert (after.paths.length[:, others] == before.paths.length[:, others]).all()
    assert (after.paths.arms[:, others] == before.paths.arms[:, others]).all()


def test_paths_are_those_of_opensim_round_displaced_cylinders(hidden):
    world = hidden.world
    rows = [world.leg.names.index(name) for name in WRAPPED]
    frames = np.arange(200, 1700, 130)  # mostly frames that were interpolated
    length, arms = muscle_paths(world.leg, world.walk.angles[0][:, frames], rows)
    assert np.abs(world.paths.length[0][rows][:, frames] - length).max() < 2e-4
    off = world.paths.arms[0][rows][..., frames] - arms
    assert np.sqrt((off**2).mean()) < 2e-4
    moved = world.paths.arms[0][rows] - hidden.who.world.paths.arms[0][rows]
    assert np.abs(moved).mean(axis=-1).max() > 1e-3


def test_mean_fiber_lengths_are_unchanged(hidden):
    before, after = hidden.who.world, hidden.world
    stretch = [(w.paths.length.mean(axis=(0, 2)) - w.muscles.tendon_slack_length) for w in (before, after)]
    assert np.allclose(*stretch, atol=1e-12)


def test_subject_has_the_nominal_model_and_truth_files_the_true_one(hidden, folder):
    subject = load_subject(folder / "subject")
    text = (folder / "subject" / "model.osim").read_text(encoding="utf-8")
    for cylinder in hidden.who.nominal.cylinders:
        assert f"<radius>{cylinder.radius:.9g}</radius>" in text
    wraps = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["wraps"]
    (first, *_), (true, *_) = hidden.who.nominal.cylinders, hidden.world.leg.cylinders
    assert wraps[first.name][5] == pytest.approx(true.radius / first.radius)
    assert wraps[first.name][:3] == pytest.approx(np.array(true.translation) - first.translation)
    with np.load(folder / "truth.npz") as truth:
        assert truth["arms"].shape == (len(subject.trials.names), len(hidden.world.leg.muscles), 6, 101)
        assert tuple(truth["coordinates"]) == COORDINATES
        # Cycles and frames are those of the subject: spot check by OpenSim at the recorded angles.
        columns = [subject.trials.coordinates.index(name) for name in COORDINATES]
        angles = subject.trials.angles[-1][columns][:, [10, 55]]
        row = hidden.world.leg.names.index("vasmed_r")
        _, arms = muscle_paths(hidden.world.leg, angles, [row])
        assert truth["arms"][-1, row][:, [10, 55]] == pytest.approx(arms[0], abs=3e-4)


def test_true_arms_are_sampled_over_whole_cycles(hidden):
    world = hidden.world
    times = at_frames(world, np.tile(world.walk.time, (len(world.walk.speeds), 1)))
    assert (np.diff(times) > 0.0).all() and np.ptp(np.diff(times), axis=1).max() < 1e-9


def test_rotation_is_body_fixed_as_in_opensim():
    """Rotate about x first, then about the rotated y axis."""
    x, y = 0.2, -0.3
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    cylinder = Cylinder("one", "pelvis", (0.0, 0.0, 0.0), (x, y, 0.0), 0.02, 0.1, "+x")
    assert axis_of(cylinder) == pytest.approx(about_x @ about_y @ [0, 0, 1])


def test_clearance_is_negative_for_a_point_inside():
    leg = reference_leg(72.0, 1.72)
    (hip, *_) = leg.cylinders
    assert clearance(leg, hip) > 0.0
    assert clearance(leg, replace(hip, radius=2.0 * hip.radius)) < 0.0


def test_other_prior_applies_to_translations_only():
    wraps = freed_wraps([["wide", "narrow"]], {"wide": 0.02, "narrow": 0.005})
    asked = with_prior(wraps, 0.015).prior_sd
    assert (asked[:, :3] == 0.015).all() and (asked[:, 3:] == wraps.prior_sd[:, 3:]).all()


def arms(*values):
    """Build arms with a row for each muscle and a column for each coordinate, constant over cycles."""
    return np.broadcast_to(np.array(values)[:, None, :, None], (len(values), 2, len(values[0]), 3))


def test_errors_are_over_chosen_arms_only():
    true, before, after = arms((0.0, 0.0)), arms((3e-3, 9.0)), arms((1e-3, 7.0))
    own = arm_errors(true, before, after, np.array([[True, False]]))
    assert own == {
        "arms": 1,
        "before_m": pytest.approx(3e-3),
        "after_m": pytest.approx(1e-3),
        "ratio": pytest.approx(1 / 3),
    }
    both = arm_errors(true, arms((3e-3, 4e-3)), after, np.array([[True, True]]))
    assert both["before_m"] == pytest.approx(np.sqrt(12.5) * 1e-3)
    assert arm_errors(true, before, after, np.array([[False, False]]))["ratio"] is None


def test_identifiable_arms_are_displaced_free_and_determined():
    true = arms(*[(2e-3, 2e-3, 2e-3, 0.0)] * 2)
    undisplaced = arms(*[(0.0, 0.0, 2e-3, 0.0)] * 2)  # the arm about the third coordinate is not changed
    nominal = arms(*[(1e-3, 1e-3, 1e-3, 1e-3)] * 2)
    deviation = np.array([[9e-5, 1.1e-4, 0.0, 0.0]] * 2)
    touched, identifiable = identifiable_and_touched(
        true, undisplaced, nominal, deviation, np.array([True, False])
    )
    assert touched.tolist() == [[True, True, False, False], [False] * 4]
    assert identifiable.tolist() == [[True, False, False, False], [False] * 4]


def test_person_without_arms_counts_as_no_decrease():
    own = decrease([0.5, 0.9, 1.2, None])
    assert (own["fallen"], own["of"], own["judged"], own["median_ratio"]) == (2, 4, 3, 0.9)
    # For twenty values the bounds are the 6th and the 15th, by the binomial distribution.
    many = decrease([0.1 * step for step in range(1, 21)])
    assert many["median_interval"] == [pytest.approx(0.6), pytest.approx(1.5)]
    assert decrease([None])["median_interval"] == [None, None]


def result_with(ratio):
    judged = {"arms": 2, "before_m": 2e-3, "after_m": 2e-3 * ratio, "ratio": ratio}
    moments = {
        "NGA": {"calibration": 6.0, "validation": 8.0},
        "PGA": {"calibration": 5.4, "validation": 8.0},
    }
    distance = {"before": 0.8, "after": 0.8 * ratio, "ratio": ratio, "bound": 0.4}
    return {
        "told": judged,
        "touched": judged,
        "moments_Nm": moments,
        "converged": {"PGA": True},
        "distance": distance,
    }


def test_summary_counts_decreases_and_moment_errors():
    text = lines(summary([result_with(0.5), result_with(1.5), result_with(0.7)]))
    assert text[0].startswith("identifiable arms: errors decrease in 2 of 3, median ratio 0.70")
    assert "decreases in 2 of 3, median ratio 0.70; bound 0.50; 1.40 times the bound" in text[2]
    assert text[3] == "calibration cycles: NGA 6.00, PGA 5.40 N m (-10.0 %)"


def test_stored_results_are_reused(monkeypatch, tmp_path, capsys):
    asked = []

    def evaluate(one, place):
        asked.append(one.result)
        result = {"asked": vars(one), **result_with(0.5)}
        (place / one.result).write_text(json.dumps(result), encoding="utf-8")
        return result

    monkeypatch.setattr(hidden_wraps, "evaluate", evaluate)
    people = [Question(0, 0.1), Question(1, 0.1)]
    evaluate_all(people[:1], tmp_path)
    assert len(evaluate_all(people, tmp_path)) == 2
    evaluate_all([Question(1, 0.1, prior=0.005)], tmp_path)
    assert asked == [people[0].result, people[1].result, Question(1, 0.1, prior=0.005).result]
    assert "1/2 seed 0: identifiable 2 arms 2.00 -> 1.00 mm (0.50)" in capsys.readouterr().err


def wraps_of_two():
    return freed_wraps([["first"], ["second"]], {"first": 0.03, "second": 0.02})


def test_distance_is_in_standard_deviations_of_displacements():
    wraps = wraps_of_two()
    nominal = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    moved = [PLACE, 0.0, -PLACE, TURN, 0.0, 1.0 + RADIUS]
    truth = {"first": moved, "second": nominal}
    none, all_found = np.zeros((2, 6)), np.array([np.array(moved) - nominal, np.zeros(6)])
    assert distance_to_truth(wraps, truth, none)["ratio"] == 1.0
    found = distance_to_truth(wraps, truth, all_found)
    assert found["before"] == pytest.approx(np.sqrt(4 / 12)) and found["after"] < 1e-12


class Problem:
    """What the bound needs of an objective: parameters of two wraps, and the derivatives of the moments."""

    def __init__(self, wraps, rows):
        self.rows = rows
        index = np.full((2, 6), 12)
        numbers = np.arange(12).reshape(2, 6)
        index[wraps.free] = numbers[wraps.free]
        self.variables = SimpleNamespace(
            upper=np.ones(12), lower=-np.ones(12), prior_precision=np.ones(12), index=index, modes=6, count=12
        )

    def moment_jacobian(self, variables):
        return self.rows


@pytest.mark.parametrize("informative", [False, True])
def test_bound_is_the_prior_without_information_and_small_with_much(hidden, folder, informative):
    subject, wraps = load_subject(folder / "subject"), wraps_of_two()
    rows = (1e6 if informative else 0.0) * np.eye(12)
    bound = bound_of_distance(Problem(wraps, rows), np.zeros(12), subject, wraps)
    held = (~wraps.free).mean()
    assert bound == pytest.approx(np.sqrt(held) if informative else 1.0, abs=1e-3)


def test_the_bound_of_one_number_is_that_of_a_normal_posterior(folder):
    """Prior and data add their precisions: moments change by 3 N m for one displacement."""
    subject, wraps = load_subject(folder / "subject"), wraps_of_two()
    samples = sum(samples_by_recording(subject.trials.used_for("calibration")).values())
    per_unit = MOMENT_NOISE / MOMENT_ERROR / np.sqrt(samples) * wraps.scale[0, 0] / PLACE
    rows = np.zeros((1, 12))
    rows[0, 0] = per_unit
    bound = bound_of_distance(Problem(wraps, rows), np.zeros(12), subject, wraps)
    assert bound == pytest.approx(np.sqrt((11 + 0.5) / 12))


@pytest.fixture(scope="module")
def with_tasks(hidden, tmp_path_factory):
    place = tmp_path_factory.mktemp("people") / "two"
    write_hidden(hidden, 3, 0.1, place, tasks=True)
    return place


def test_trials_of_a_dynamometer_leave_the_walk_as_it_was(folder, with_tasks):
    for file in (folder / "subject" / "trials").rglob("*.*"):
        assert (with_tasks / file.relative_to(folder)).read_bytes() == file.read_bytes()
    trials = load_subject(with_tasks / "subject").trials
    walked = load_subject(folder / "subject").trials
    np.testing.assert_array_equal(trials.moments[trials.is_gait], walked.moments)
    assert set(trials.tasks) == {"gait", "passive", "isometric"}
    of_device = np.isfinite(trials.moments[~trials.is_gait]).any(axis=-1)
    assert (of_device.sum(axis=1) <= 1).all()


def test_rotations_end_where_the_joint_resists(hidden):
    for trial in PASSIVE:
        done = perform(hidden.world, trial)
        assert np.abs(done.moment).max() < RESISTANCE + 1.0
        assert done.envelopes.max() == 0.0 and done.pose.shape == (12, done.time.size)


@pytest.mark.parametrize("trial", ISOMETRIC[::5], ids=lambda one: one.name)
def test_a_ramp_pushes_its_way_and_the_moment_is_that_of_opensim_s_paths(hidden, trial):
    world = hidden.world
    done = perform(world, trial)
    middle = done.time.size // 2
    effort = done.moment[middle + 60] - done.moment[0]
    assert effort * trial.sign > 5.0
    assert done.envelopes[:, middle].max() <= 1.5 and done.envelopes[:, middle].min() >= 0.02 - 1e-12
    row = COORDINATES.index(trial.coordinate)
    length, arms = muscle_paths(world.leg, done.pose[6:, :1])
    at_rest = muscle_forces(
        world.curves, world.muscles, np.zeros((1, len(length), 1)), length[None], 0.0 * length[None], 0.002
    )
    first = float((arms[:, row, 0] * at_rest[0, :, 0]).sum())
    assert done.moment[0] == pytest.approx(first, abs=15.0)
