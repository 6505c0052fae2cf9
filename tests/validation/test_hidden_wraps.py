"""Defends: hidden cylinders are those OpenSim wraps round, and how near arms came to the truth is counted."""

import json
from dataclasses import replace

import numpy as np
import pytest

from validation.blind import gait, person
from validation.blind.anatomy import COORDINATES, Cylinder, reference_leg
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
from validation.blind.hidden_wraps import hidden_wraps as somebody
from validation.blind.opensim_leg import muscle_paths
from validation.calibration import hidden_wraps
from validation.calibration.hidden_wraps import (
    Asked,
    answer_all,
    arm_errors,
    arms_that_count,
    fallen,
    lines,
    summary,
    with_prior,
)
from wrapjax.path_sources.wrap_freedom import freed_wraps
from wrapjax.subject.subject import load_subject

WRAPPED = ("iliacus_r", "psoas_r", "recfem_r", "vasmed_r", "vaslat_r", "gasmed_r", "gaslat_r")


@pytest.fixture(scope="module")
def hidden():
    """Somebody who walks for a few seconds only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gait, "DURATION", 4.0)
        patch.setattr(person, "_SPEEDS", ((1.1, 1.2),) * len(person._SPEEDS))
        yield somebody(3)


@pytest.fixture(scope="module")
def folder(hidden, tmp_path_factory):
    place = tmp_path_factory.mktemp("people") / "one"
    write_hidden(hidden, 3, 0.1, place)
    return place


def test_every_cylinder_is_displaced_as_far_as_is_said_and_no_other_muscle_knows(hidden):
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


def test_paths_are_those_that_opensim_lays_round_displaced_cylinders(hidden):
    world = hidden.world
    rows = [world.leg.names.index(name) for name in WRAPPED]
    frames = np.arange(200, 1700, 130)  # mostly frames at which nobody was asked before
    length, arms = muscle_paths(world.leg, world.walk.angles[0][:, frames], rows)
    assert np.abs(world.paths.length[0][rows][:, frames] - length).max() < 2e-4
    off = world.paths.arms[0][rows][..., frames] - arms
    assert np.sqrt((off**2).mean()) < 2e-4
    moved = world.paths.arms[0][rows] - hidden.who.world.paths.arms[0][rows]
    assert np.abs(moved).mean(axis=-1).max() > 1e-3


def test_fibers_stay_where_they_were(hidden):
    before, after = hidden.who.world, hidden.world
    stretch = [(w.paths.length.mean(axis=(0, 2)) - w.muscles.tendon_slack_length) for w in (before, after)]
    assert np.allclose(*stretch, atol=1e-12)


def test_the_laboratory_gets_the_believed_model_and_the_truth_lies_beside(hidden, folder):
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
        # Cycles and frames are the subject's: a spot check by OpenSim at the angles that were recorded.
        columns = [subject.trials.coordinates.index(name) for name in COORDINATES]
        angles = subject.trials.angles[-1][columns][:, [10, 55]]
        row = hidden.world.leg.names.index("vasmed_r")
        _, arms = muscle_paths(hidden.world.leg, angles, [row])
        assert truth["arms"][-1, row][:, [10, 55]] == pytest.approx(arms[0], abs=3e-4)


def test_the_truth_is_sampled_from_the_first_frame_of_a_cycle_to_its_last(hidden):
    world = hidden.world
    times = at_frames(world, np.tile(world.walk.time, (len(world.walk.speeds), 1)))
    assert (np.diff(times) > 0.0).all() and np.ptp(np.diff(times), axis=1).max() < 1e-9


def test_axes_turn_as_opensim_turns_them():
    """Body-fixed: about x first, then about the new y."""
    x, y = 0.2, -0.3
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    cylinder = Cylinder("one", "pelvis", (0.0, 0.0, 0.0), (x, y, 0.0), 0.02, 0.1, "+x")
    assert axis_of(cylinder) == pytest.approx(about_x @ about_y @ [0, 0, 1])


def test_a_cylinder_that_swallows_a_point_is_told():
    leg = reference_leg(72.0, 1.72)
    (hip, *_) = leg.cylinders
    assert clearance(leg, hip) > 0.0
    assert clearance(leg, replace(hip, radius=2.0 * hip.radius)) < 0.0


def test_another_prior_is_of_places_alone_whatever_their_boxes():
    wraps = freed_wraps([["wide", "narrow"]], {"wide": 0.02, "narrow": 0.005})
    asked = with_prior(wraps, 0.015).prior_sd
    assert (asked[:, :3] == 0.015).all() and (asked[:, 3:] == wraps.prior_sd[:, 3:]).all()


def arms(*values):
    """One muscle a row, one coordinate a column; alike in two cycles of three frames."""
    return np.broadcast_to(np.array(values)[:, None, :, None], (len(values), 2, len(values[0]), 3))


def test_errors_are_of_the_chosen_arms_alone():
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


def test_arms_count_that_were_displaced_and_may_move_and_can_be_told():
    true = arms(*[(2e-3, 2e-3, 2e-3, 0.0)] * 2)
    undisplaced = arms(*[(0.0, 0.0, 2e-3, 0.0)] * 2)  # the third coordinate's arm knows of no cylinder
    believed = arms(*[(1e-3, 1e-3, 1e-3, 1e-3)] * 2)
    deviation = np.array([[9e-5, 1.1e-4, 0.0, 0.0]] * 2)
    touched, told = arms_that_count(true, undisplaced, believed, deviation, np.array([True, False]))
    assert touched.tolist() == [[True, True, False, False], [False] * 4]
    assert told.tolist() == [[True, False, False, False], [False] * 4]


def test_who_cannot_be_judged_has_not_fallen():
    own = fallen([0.5, 0.9, 1.2, None])
    assert (own["fallen"], own["of"], own["judged"], own["median_ratio"]) == (2, 4, 3, 0.9)
    # Twenty: the 6th and the 15th, by the binomial distribution.
    many = fallen([0.1 * step for step in range(1, 21)])
    assert many["median_interval"] == [pytest.approx(0.6), pytest.approx(1.5)]
    assert fallen([None])["median_interval"] == [None, None]


def made_up(ratio):
    judged = {"arms": 2, "before_m": 2e-3, "after_m": 2e-3 * ratio, "ratio": ratio}
    moments = {
        "NGA": {"calibration": 6.0, "validation": 8.0},
        "PGA": {"calibration": 5.4, "validation": 8.0},
    }
    return {"told": judged, "touched": judged, "moments_Nm": moments, "converged": {"PGA": True}}


def test_a_summary_says_in_how_many_errors_fell_and_what_moments_do():
    said = lines(summary([made_up(0.5), made_up(1.5), made_up(0.7)]))
    assert said[0].startswith("arms that can be told from gains: errors fall in 2 of 3, median ratio 0.70")
    assert said[2] == "calibration cycles: NGA 6.00, PGA 5.40 N m (-10.0 %)"


def test_a_person_who_was_answered_is_not_asked_again(monkeypatch, tmp_path, capsys):
    asked = []

    def answer(one, place):
        asked.append(one.result)
        result = {"asked": vars(one), **made_up(0.5)}
        (place / one.result).write_text(json.dumps(result), encoding="utf-8")
        return result

    monkeypatch.setattr(hidden_wraps, "answer", answer)
    people = [Asked(0, 0.1), Asked(1, 0.1)]
    answer_all(people[:1], tmp_path)
    assert len(answer_all(people, tmp_path)) == 2
    answer_all([Asked(1, 0.1, prior=0.005)], tmp_path)
    assert asked == [people[0].result, people[1].result, Asked(1, 0.1, prior=0.005).result]
    assert "1/2 seed 0: told 2 arms 2.00 -> 1.00 mm (0.50)" in capsys.readouterr().err
