"""Joint contact forces of stored runs agree with Newton's laws; unusable runs are refused."""

import json
import shutil

import numpy as np
import opensim
import pytest

from tests.contact_forces.synthetic_run import MUSCLES, muscle_forces, write_run
from tests.subject import synthetic
from tests.subject.synthetic_forces import POINT, TORQUE, force, with_forces
from wrapjax.cli.contact import contact_table
from wrapjax.contact_forces.contact_force import contact
from wrapjax.contact_forces.contact_result import GRAVITY, JOINT_REACTION, MUSCLE_SHARE, peaks
from wrapjax.errors import InputError
from wrapjax.evaluation.stored_run import load_run
from wrapjax.subject.subject import load_subject

#: Of both segments of the synthetic leg: kg, m, m.
MASS, LENGTH, TO_CENTER = 5.0, 0.4, 0.2
#: Where both muscles come from in ground and end on the shank: forward, m; and how far below the knee.
FORWARD, BELOW = np.array([0.05, -0.05]), -0.05


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    """Subject with ground forces."""
    return with_forces(tmp_path_factory.mktemp("forces") / "person")


@pytest.fixture(scope="module")
def without_forces(tmp_path_factory):
    """Subject without ground forces."""
    return load_subject(synthetic.write_subject(tmp_path_factory.mktemp("without_forces") / "person"))


@pytest.fixture(scope="module")
def runs(subject, tmp_path_factory):
    place = tmp_path_factory.mktemp("runs")
    return write_run(place / "nga", subject), write_run(place / "pga", subject, "PGA", factor=1.2)


@pytest.fixture(scope="module")
def compared(runs):
    return contact(*runs)


def places(time):
    """Angles of thigh and shank; positions of the knee and of the muscles' ends in ground, by frame."""
    hip, knee = synthetic.angles(time)
    thigh, shank = hip, hip + knee
    at_knee = LENGTH * np.stack([np.sin(thigh), -np.cos(thigh), 0.0 * thigh])
    ends = [
        at_knee
        + np.stack(
            [
                forward * np.cos(shank) - BELOW * np.sin(shank),
                forward * np.sin(shank) + BELOW * np.cos(shank),
                0.0 * shank,
            ]
        )
        for forward in FORWARD
    ]
    return thigh, shank, np.array(ends)


def pulls(time, factor=1.0):
    """Force (N) of both muscles on the leg in ground, from the shank to the pelvis."""
    _, _, ends = places(time)
    origin = np.stack([FORWARD, 0.0 * FORWARD, 0.0 * FORWARD], axis=1)[:, :, None]
    along = (origin - ends) / np.linalg.norm(origin - ends, axis=1, keepdims=True)
    return (along * muscle_forces(time, factor)[:, None]).sum(axis=0)


def required_forces(time):
    """Forces (N) that carry and accelerate both segments, by the equations of a double pendulum."""
    turn = 2.0 * np.pi / synthetic.PERIOD
    change = -(turn**2) * (synthetic.angles(time) - np.array([0.2, 0.6])[:, None])
    rate = synthetic.angular_velocities(time)
    thigh, shank, _ = places(time)

    def accelerated(length, angle, speed, change):
        """Acceleration of the end of a rod that hangs down."""
        x = change * np.cos(angle) - speed**2 * np.sin(angle)
        y = change * np.sin(angle) + speed**2 * np.cos(angle)
        return length * np.stack([x, y, 0.0 * x])

    first = (thigh, rate[0], change[0])
    second = (shank, rate.sum(axis=0), change.sum(axis=0))
    both = accelerated(TO_CENTER, *first) + accelerated(LENGTH, *first) + accelerated(TO_CENTER, *second)
    return MASS * (both + 2.0 * np.array([0.0, GRAVITY, 0.0])[:, None])


def test_the_hip_force_agrees_with_newton(subject, compared):
    result = compared.result
    assert (result.kind, result.reason) == (JOINT_REACTION, "")
    assert result.joints == {"hip": "hip_l", "knee": "knee_l"}
    for run, factor in zip(result.runs, (1.0, 1.2), strict=True):
        for trial, time in enumerate(subject.trials.time):
            on_leg = required_forces(time) - force(time) - pulls(time, factor)
            # Accelerations are those of a spline through samples, which is less accurate at the ends of
            # cycles.
            inner = slice(5, -5)
            np.testing.assert_allclose(
                run.force[trial, 0, :, inner], -on_leg[:, inner], atol=2e-3 * np.abs(on_leg).max()
            )


@pytest.fixture(scope="module")
def divided(runs):
    return contact(*runs, condyle_distance=0.04)


def test_the_frontal_moment_of_the_ground_force_loads_one_compartment(subject, divided):
    """Muscles and masses lie in the sagittal plane: only the ground force has a frontal moment."""
    result = divided.result
    for run in result.runs:
        for trial, time in enumerate(subject.trials.time):
            thigh, shank, _ = places(time)
            knee = LENGTH * np.stack([np.sin(thigh), -np.cos(thigh), 0.0 * thigh])
            turned = np.cross(POINT[:, None] - knee, force(time), axis=0) + TORQUE[:, None]
            forward = np.stack([np.cos(shank), np.sin(shank), 0.0 * shank])
            medial, lateral = run.compartments[trial]
            # A left knee: the moment of the femur has the opposite sign.
            held = -(forward * turned).sum(axis=0)
            np.testing.assert_allclose(medial - lateral, 2.0 * held / 0.04, atol=0.1)
            # Forces along the thigh are rotated into the shank by the knee's angle.
            on_thigh, bent = run.force[trial, 1], shank - thigh
            along = np.cos(bent) * on_thigh[1] - np.sin(bent) * on_thigh[0]
            np.testing.assert_allclose(medial + lateral, along, rtol=1e-6, atol=1e-2)


def test_compartments_are_in_all_outputs(divided, tmp_path):
    result = divided.result
    divided.save(tmp_path / "contact")
    content = json.loads((tmp_path / "contact" / "contact.json").read_text())
    found = content["knee_compartments"]
    assert (found["condyle_distance_m"], content["knee_compartments_reason"]) == (0.04, None)
    medial = result.runs[1].compartments[:, 0]
    assert found["runs"]["PGA"]["medial"]["peak"]["mean_N"] == pytest.approx(medial.max(axis=1).mean())
    tested = {(entry["joint"], entry["measure"]) for entry in content["tests"]}
    assert {("medial knee", "peak"), ("lateral knee", "peak")} <= tested
    table = opensim.TimeSeriesTable(str(tmp_path / "contact" / "forces" / "PGA" / "walk_b.sto"))
    column = table.getDependentColumn("medial_knee_force").to_numpy()
    np.testing.assert_allclose(column, medial[result.trials.index("walk_b")], rtol=1e-9)
    labelled = divided.to_dataset()["knee_compartment_force"].sel(run="PGA", compartment="medial")
    np.testing.assert_array_equal(labelled, medial)
    assert "40 mm apart" in (tmp_path / "contact" / "report.html").read_text()
    assert "medial knee, peak" in contact_table(divided)


def test_a_knee_is_not_divided_without_a_distance(compared, runs, without_forces, tmp_path):
    assert compared.result.undivided_reason.startswith("the model's knee is one joint")
    assert compared.result.runs[0].compartments is None
    share = contact(write_run(tmp_path / "run", without_forces), condyle_distance=0.04).result
    assert share.condyle_distance is None and "only the contribution of the muscles" in share.undivided_reason
    for distance in (40.0, -0.04, float("nan")):
        with pytest.raises(InputError, match=r"m apart, where 0\.01 to 0\.12 m were expected"):
            contact(*runs, condyle_distance=distance)


def test_forces_are_labelled(compared):
    result, dataset = compared.result, compared.to_dataset()
    at = {"run": "PGA", "trial": "walk_b", "joint": "knee"}
    trial = result.trials.index("walk_b")
    np.testing.assert_array_equal(
        dataset["contact_force"].sel(at | {"axis": "y"}), result.runs[1].force[trial, 1, 1]
    )
    size = np.sqrt((dataset["contact_force"] ** 2).sum("axis"))
    np.testing.assert_allclose(size, dataset["contact_force_magnitude"], rtol=1e-12)
    assert all(dataset[name].attrs["units"] for name in dataset)


def test_without_ground_forces_it_is_the_muscles_share(without_forces, tmp_path):
    found = contact(write_run(tmp_path / "run", without_forces)).result
    assert found.kind == MUSCLE_SHARE
    assert "no ground reaction forces" in found.reason
    for trial, time in enumerate(without_forces.trials.time):
        # Angles are those of a spline through samples.
        np.testing.assert_allclose(found.runs[0].force[trial, 0], pulls(time), atol=1e-4)


def test_pga_uses_the_model_that_it_wrote(without_forces, tmp_path):
    folder = write_run(tmp_path / "run", without_forces, "PGA")
    before = contact(folder).result.runs[0].force
    model = folder / "model_personalized.osim"
    # The semitendinosus' origin, 30 mm further back.
    model.write_text(model.read_text().replace("<location>-0.05 0.0 0<", "<location>-0.08 0.0 0<"))
    assert np.abs(contact(folder).result.runs[0].force - before).max() > 5.0
    model.unlink()
    with pytest.raises(InputError, match=r"model_personalized\.osim: is missing"):
        contact(folder)


def without_electrode(folder):
    """Folder of a subject whose semitendinosus has no electrode."""
    synthetic.write_subject(folder)
    settings = folder / "subject.toml"
    settings.write_text(settings.read_text().replace('SemiTen = ["semiten_l"]\n', ""))
    return folder


@pytest.fixture
def partly_driven(tmp_path):
    """A subject whose semitendinosus has no electrode, and a run of it."""
    subject = load_subject(without_electrode(tmp_path / "person"))
    return subject, write_run(tmp_path / "run", subject, muscles=MUSCLES[:1])


def test_undriven_muscles_balance_moments_or_have_no_force(partly_driven):
    subject, folder = partly_driven
    closing, nothing = (
        contact(folder, undriven=treatment).result.runs[0] for treatment in ("static-optimization", "left")
    )
    assert closing.undriven.muscles == ("semiten_l",)
    assert (nothing.undriven.muscles, nothing.undriven.without_force) == ((), ("semiten_l",))
    # Residuals are measured less modelled moments less those of the muscle.
    np.testing.assert_allclose(nothing.undriven.residual, 0.5 * subject.trials.moments, atol=1e-9)
    assert np.square(closing.undriven.residual).sum() < np.square(nothing.undriven.residual).sum()
    assert closing.undriven.activation.max() > 0.1
    # It runs straight and in the sagittal plane: it adds its force to both joints, without a lateral
    # component.
    added = np.linalg.norm(closing.force - nothing.force, axis=2)
    np.testing.assert_allclose(added, closing.undriven.force[0][:, None].repeat(2, axis=1), rtol=1e-9)


@pytest.mark.parametrize("method", ["NGA", "PGA"])
def test_muscle_parameters_take_precedence_for_undriven_muscles(tmp_path, method):
    """As for all other muscles: the table of parameters is used instead of the model."""
    plain, listed, edited = (without_electrode(tmp_path / name) for name in ("plain", "listed", "edited"))
    synthetic.add_muscle_parameters(
        listed, ("recfem_l", 1500.0, 0.1, 0.3, 0.1), ("semiten_l", 450.0, 0.14, 0.31, 0.2)
    )
    model = edited / "model.osim"
    before, own = model.read_text().split('name="semiten_l"')
    for tag, old, new in (
        ("max_isometric_force", "900.0", "450.0"),
        ("optimal_fiber_length", "0.15", "0.14"),
        ("tendon_slack_length", "0.25", "0.31"),
        ("pennation_angle_at_optimal", "0.1", "0.2"),
    ):
        assert f"<{tag}>{old}<" in own
        own = own.replace(f"<{tag}>{old}<", f"<{tag}>{new}<")
    model.write_text(f'{before}name="semiten_l"{own}')
    found = []
    for folder in (plain, listed, edited):
        run = write_run(folder / "run", load_subject(folder), method, muscles=MUSCLES[:1])
        if method == "PGA":
            # Parameters are those of the subject, not of the model.
            shutil.copy(plain / "model.osim", run / "model_personalized.osim")
        found.append(contact(run).result.runs[0].undriven)
    np.testing.assert_allclose(found[1].activation, found[2].activation, rtol=1e-12)
    np.testing.assert_allclose(found[1].force, found[2].force, rtol=1e-12)
    assert np.abs(found[1].force - found[0].force).max() > 10.0


def test_peaks_are_searched_within_their_window():
    def shape(phase):
        return 2.0 * np.exp(-((phase - 20.0) ** 2) / 50.0) + 3.0 * np.exp(-((phase - 50.0) ** 2) / 50.0)

    percent = np.linspace(0.0, 100.0, 101)
    curve = shape(percent)
    assert peaks(curve[None], percent[None], (0.0, 100.0)).phase == [50.0]
    first = peaks(curve[None], percent[None], (10.0, 30.0))
    assert (first.phase, first.frame) == ([20.0], [20])
    np.testing.assert_allclose(first.force, 2.0, rtol=1e-3)
    # In a cycle that starts in the middle, the same peaks are in other frames.
    later = percent[None] + 40.0
    first = peaks(shape(later % 100.0), later, (10.0, 30.0))
    assert (first.phase, first.frame) == ([20.0], [80])
    nowhere = peaks(curve[None, 50:], percent[None, 50:], (10.0, 30.0))
    assert np.isnan(nowhere.force).all() and np.isnan(nowhere.phase).all()


def test_phases_count_from_recorded_strikes(compared, subject):
    """The foot strikes the ground where the synthetic force starts, at a known time of each cycle."""
    result = compared.result
    time = np.arange(0.0, 4.0, 1e-4)
    on = force(time)[1] > 30.0
    strikes = time[1:][on[1:] & ~on[:-1]]
    for phase, frames in zip(result.phase, subject.trials.time, strict=True):
        step = frames[1] - frames[0]
        if strikes[0] <= frames[0] + step and frames[-1] <= strikes[-1]:
            before = strikes[strikes <= frames[0] + step][-1]
            expected = np.maximum(100.0 * (frames - before) / synthetic.PERIOD, 0.0)
            np.testing.assert_allclose(phase, expected, atol=0.5)
        else:
            np.testing.assert_array_equal(phase, np.linspace(0.0, 100.0, len(frames)))
    assert any(phase[0] > 5.0 for phase in result.phase)


def test_saved_files(compared, tmp_path):
    out = tmp_path / "contact"
    compared.save(out)
    content = json.loads((out / "contact.json").read_text())
    assert (content["schema"], content["kind"]) == (1, JOINT_REACTION)
    one, other = content["runs"]
    hip = one["joints"]["hip"]["peak"]
    trials = hip["trials"].values()
    assert hip["mean_N"] == pytest.approx(np.mean([entry["N"] for entry in trials]))
    assert hip["mean_bodyweights"] == pytest.approx(hip["mean_N"] / (synthetic.MASS * GRAVITY))
    difference = other["joints"]["hip"]["peak"]["mean_bodyweights"] - hip["mean_bodyweights"]
    tests = {(entry["joint"], entry["measure"]): entry["test"] for entry in content["tests"]}
    assert set(tests) == {("hip", "peak"), ("hip", "first_peak"), ("knee", "peak")}
    assert tests["hip", "peak"]["difference"] == pytest.approx(difference)
    assert tests["hip", "peak"]["n"] == 3
    table = opensim.TimeSeriesTable(str(out / "forces" / "NGA" / "walk_a_01.sto"))
    labels = table.getColumnLabels()
    assert labels[:4] == ("hip_force_x", "hip_force_y", "hip_force_z", "hip_force")
    size = np.array([table.getDependentColumn("hip_force").to_numpy()])[0]
    assert size.max() == pytest.approx(hip["trials"]["walk_a/01"]["N"])
    with pytest.raises(InputError, match="exists already"):
        compared.save(out)


def broken(folder, subject):
    """Runs that cannot be used, with the error message."""
    other = write_run(folder / "sga", subject, "SGA")
    yield other, "was made by SGA, which adjusts polynomials"
    yield folder / "nothing", "does not exist; a RUN is what 'wrapjax calibrate' writes"
    empty = folder / "empty"
    empty.mkdir()
    yield empty, "is no RUN folder: summary.json is missing"
    cut = write_run(folder / "cut", subject)
    (cut / "settings.json").write_text("{")
    yield cut, "settings.json: is damaged"
    lean = write_run(folder / "lean", subject)
    (lean / "settings.json").write_text("{}")
    yield lean, "is damaged (no 'muscles')"
    without = write_run(folder / "without", subject)
    shutil.rmtree(without / "muscle_forces")
    yield without, "muscle_forces"
    late = write_run(folder / "late", subject)
    file = late / "moments" / "walk_b.sto"
    shutil.copy(late / "moments" / "walk_a_01.sto", file)
    yield late, "expected the frames of cycle 'walk_b', 0.6 to 1.8 s"


def test_unusable_runs_are_refused(without_forces, tmp_path):
    for folder, words in broken(tmp_path, without_forces):
        with pytest.raises(InputError) as caught:
            contact(folder)
        assert words in str(caught.value), folder


def test_a_moved_subject_is_requested(without_forces, tmp_path):
    subject = load_subject(shutil.copytree(without_forces.folder, tmp_path / "person"))
    folder = write_run(tmp_path / "run", subject)
    shutil.move(tmp_path / "person", tmp_path / "elsewhere")
    with pytest.raises(InputError, match="name it with --subject"):
        contact(folder)
    for run in (folder, load_run(folder)):
        assert contact(run, subject=tmp_path / "elsewhere").subject.name == "synthetic"


def test_a_subject_with_other_cycles_is_refused(without_forces, tmp_path):
    folder = write_run(tmp_path / "run", without_forces)
    other = shutil.copytree(without_forces.folder, tmp_path / "other")
    settings = other / "subject.toml"
    settings.write_text(settings.read_text().replace('name = "walk_b"', 'name = "walk_c"'))
    with pytest.raises(InputError, match=r"to have the cycles .*walk_b, found .*walk_c"):
        contact(folder, subject=other)


def test_runs_of_two_subjects_are_not_compared(without_forces, subject, tmp_path):
    with pytest.raises(InputError, match="compare runs of one subject"):
        contact(write_run(tmp_path / "one", without_forces), write_run(tmp_path / "two", subject))
