"""Tests of muscle lengths and moment arms by OpenSim: accuracy, worker processes, cache, errors."""

import multiprocessing
import signal
import subprocess
import sys

import numpy as np
import opensim
import pytest

from wrapjax.errors import InputError
from wrapjax.io.store import Store
from wrapjax.osim import muscle_analysis, workers
from wrapjax.osim.loading import load_model
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import analyse_muscles

COORDINATES = (
    "hip_flexion_l",
    "hip_adduction_l",
    "hip_rotation_l",
    "knee_angle_l",
    "ankle_angle_l",
    "subtalar_angle_l",
)
TRIALS = tuple(f"walk_0p{speed}_{number}" for speed in (5, 8) for number in (1, 2, 3, 4))


def read_table(file):
    """Column names and numbers of a .sto file."""
    lines = file.read_text().splitlines()
    start = next(number for number, line in enumerate(lines) if line.strip() == "endheader") + 1
    return lines[start].split()[1:], np.loadtxt(lines[start + 1 :])[:, 1:]


@pytest.fixture(scope="module")
def muscles(s1_left):
    return tuple(read_table(s1_left / "reference_geometry" / TRIALS[0] / "length.sto")[0])


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("WRAPJAX_CACHE", str(tmp_path))
    return tmp_path / "muscle_analysis"


def walking_poses(count, seed=0):
    """Random poses (rad) in the range of walking."""
    low, high = (-0.4, -0.2, -0.2, 0.02, -0.3, -0.2), (0.6, 0.2, 0.2, 1.1, 0.3, 0.2)
    return np.random.default_rng(seed).uniform(low, high, (count, 6))


def analyse_assembled(model_file, muscles, coordinates, poses):
    """Compute lengths and moment arms by OpenSim's usual calls, with assembly of each pose.

    Assembly changes the given coordinates too, by some 1e-7 rad. The resulting poses are returned first.
    """
    model, _ = load_model(model_file)
    found = [model.getCoordinateSet().get(name) for name in coordinates]
    paths = [model.getMuscles().get(name) for name in muscles]
    length = np.zeros((len(poses), len(paths)))
    moment_arm = np.zeros((len(poses), len(found), len(paths)))
    model.set_assembly_accuracy(1e-12)
    state = model.initSystem()
    reached = np.zeros_like(poses)
    for row, pose in enumerate(poses):
        for coordinate, value in zip(found, pose, strict=True):
            coordinate.setValue(state, value, False)
        model.assemble(state)
        model.realizePosition(state)
        reached[row] = [coordinate.getValue(state) for coordinate in found]
        length[row] = [path.getLength(state) for path in paths]
        moment_arm[row] = [[path.computeMomentArm(state, c) for path in paths] for c in found]
    np.testing.assert_allclose(reached, poses, rtol=0, atol=1e-6)
    return reached, length, moment_arm


def test_lengths_and_moment_arms_agree_with_the_published_polynomials(s1_left, muscles):
    """The published paths are sparse quintic polynomials that were fitted to this model.

    Mean differences are 0.14 mm in length and 0.02 to 0.37 mm in moment arm. The largest are at lift-off of
    the gluteus maximus from its cylinder, where OpenSim's moment arm jumps by 9 mm between frames.
    """
    length_errors, arm_errors = [], []
    for trial in TRIALS:
        names, angles = read_table(s1_left / "trials" / trial / "angles.sto")
        poses = np.radians(angles[:, [names.index(name) for name in COORDINATES]])
        found = analyse_muscles(s1_left / "model.osim", muscles, COORDINATES, poses, quiet=True)
        folder = s1_left / "reference_geometry" / trial
        length_errors.append(found.length - read_table(folder / "length.sto")[1])
        reference = [read_table(folder / f"moment_arm_{name}.sto")[1] for name in COORDINATES]
        arm_errors.append(found.moment_arm - np.stack(reference, axis=1))
    length_error = np.abs(np.concatenate(length_errors))
    arm_error = np.abs(np.concatenate(arm_errors))
    assert length_error.mean() < 0.15e-3
    assert length_error.max() < 0.92e-3
    np.testing.assert_array_less(arm_error.mean(axis=(0, 2)) * 1e3, [0.37, 0.18, 0.22, 0.17, 0.02, 0.02])
    assert np.quantile(arm_error, 0.999) < 3.5e-3
    assert arm_error.max() < 8e-3


def test_coordinates_set_by_couplers_equal_assembled_ones(s1_left, muscles):
    poses = walking_poses(4)
    reached, length, moment_arm = analyse_assembled(s1_left / "model.osim", muscles, COORDINATES, poses)
    found = analyse_muscles(s1_left / "model.osim", muscles, COORDINATES, reached, processes=1, quiet=True)
    np.testing.assert_allclose(found.length, length, rtol=0, atol=1e-8)
    # OpenSim's stale wrap points give two-cylinder paths moment arms outside their span, which are zero here.
    model = describe_model(s1_left / "model.osim")
    spanned = np.array([[c in model.spanned_by(m) for m in muscles] for c in COORDINATES])
    np.testing.assert_allclose(found.moment_arm, np.where(spanned, moment_arm, 0.0), rtol=0, atol=1e-8)


def test_moment_arms_are_minus_the_derivative_of_length_with_a_coupled_patella(s1_left):
    quadriceps = ("recfem_l", "vasint_l", "vaslat_l", "vasmed_l", "bfsh_l", "tibant_l")
    poses, step = walking_poses(40), 1e-5
    model = s1_left / "model.osim"
    found = analyse_muscles(model, quadriceps, COORDINATES, poses, processes=1, quiet=True)
    for column, _ in enumerate(COORDINATES):
        shift = step * np.eye(6)[column]
        ahead, behind = (
            analyse_muscles(
                model, quadriceps, COORDINATES, poses + sign * shift, processes=1, quiet=True
            ).length
            for sign in (1, -1)
        )
        np.testing.assert_allclose(
            found.moment_arm[:, column], (behind - ahead) / (2 * step), rtol=0, atol=1e-7
        )
    assert np.abs(found.moment_arm[:, COORDINATES.index("knee_angle_l"), :4]).min() > 0.02


def test_every_kind_of_path_and_coupler_equals_opensim(odd_model):
    """Ellipsoid, moving and conditional points, offset frames; scaled, nonlinear and chained couplers."""
    names = [muscle.name for muscle in describe_model(odd_model).muscles]
    generator = np.random.default_rng(1)
    poses = np.column_stack([generator.uniform(-0.5, 0.5, 12), generator.uniform(0.0, 1.5, 12)])
    reached, length, moment_arm = analyse_assembled(odd_model, names, ["hip", "knee"], poses)
    found = analyse_muscles(odd_model, names, ["hip", "knee"], reached, processes=1, quiet=True)
    np.testing.assert_allclose(found.length, length, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.moment_arm, moment_arm, rtol=0, atol=1e-8)
    assert np.abs(moment_arm[:, 1, names.index("extensor")]).min() > 1e-3
    assert np.abs(moment_arm[:, 1, names.index("moving")]).min() > 1e-3


@pytest.mark.parametrize(
    ("subject", "coordinates"),
    [
        ("healthy_overground", ("hip_flexion_r", "knee_angle_r", "ankle_angle_r", "mtp_angle_r")),
        ("healthy_treadmill", ("hip_flexion_l", "knee_angle_l", "ankle_angle_l", "subtalar_angle_l")),
    ],
)
def test_other_recorded_models_agree_with_opensim(data_folder, subject, coordinates):
    model = data_folder / subject / "model.osim"
    description = describe_model(model)
    muscles = [muscle.name for muscle in description.muscles if muscle.name.endswith(coordinates[0][-2:])]
    assert len(muscles) == 40
    poses = np.random.default_rng(2).uniform(0.05, 0.5, (2, len(coordinates)))
    reached, length, moment_arm = analyse_assembled(model, muscles, coordinates, poses)
    found = analyse_muscles(model, muscles, coordinates, reached, quiet=True)
    spanned = np.array([[c in description.spanned_by(m) for m in muscles] for c in coordinates])
    np.testing.assert_allclose(found.length, length, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.moment_arm, np.where(spanned, moment_arm, 0.0), rtol=0, atol=1e-8)
    assert spanned.any(axis=1).all()


def test_coordinates_not_given_stay_at_their_defaults(odd_model):
    # The toe is locked at 0.1 rad.
    both = analyse_muscles(odd_model, ["flexor"], ["hip", "knee"], np.array([[0.0, 0.7]]), quiet=True)
    alone = analyse_muscles(odd_model, ["flexor"], ["knee"], np.array([[0.7]]), quiet=True)
    np.testing.assert_array_equal(both.length, alone.length)


def test_a_pose_outside_a_clamped_range_is_not_clamped(odd_model):
    assert describe_model(odd_model).coordinate("knee").range == (0.0, 2.0)
    knee = np.array([[-0.3], [0.0], [2.0], [2.2]])
    length = analyse_muscles(odd_model, ["extensor"], ["knee"], knee, quiet=True).length[:, 0]
    assert abs(length[0] - length[1]) > 1e-3
    assert abs(length[3] - length[2]) > 1e-3


def test_several_processes_give_identical_results(empty_cache, monkeypatch, s1_left, muscles):
    monkeypatch.setattr(muscle_analysis, "CHUNK", 16)
    model, poses = s1_left / "model.osim", walking_poses(80)
    alone = analyse_muscles(model, muscles, COORDINATES, poses, processes=1, quiet=True)
    shuffled = np.random.default_rng(5).permutation(len(poses))
    monkeypatch.setenv("WRAPJAX_CACHE", str(empty_cache / "other"))
    shared = analyse_muscles(model, muscles, COORDINATES, poses[shuffled], processes=2, quiet=True)
    # Results of a pose do not depend on the pose before it.
    np.testing.assert_array_equal(shared.length, alone.length[shuffled])
    np.testing.assert_array_equal(shared.moment_arm, alone.moment_arm[shuffled])


def test_workers_are_started_when_much_work_remains(empty_cache, monkeypatch, odd_model):
    monkeypatch.setattr(muscle_analysis, "CHUNK", 4)
    monkeypatch.setattr(workers, "usable_cores", lambda: 2)
    called = []

    def in_workers(engine_arguments, chunks, processes):
        called.append((sorted(chunks), processes))
        yield from workers.analyse_chunks(*engine_arguments, chunks, 1)

    monkeypatch.setattr(workers, "_analyse_in_workers", in_workers)
    knee = np.linspace(0.1, 1.0, 12)[:, None]
    analyse_muscles(odd_model, ["flexor"], ["knee"], knee, quiet=True)
    assert called == []
    monkeypatch.setattr(workers, "POOL_PAYS_AFTER_S", 0.0)
    analyse_muscles(odd_model, ["flexor"], ["knee"], knee + 0.01, quiet=True)
    assert called == [([4, 8], 2)]


@pytest.fixture
def counted(monkeypatch):
    """Number of poses that were analyzed in each call."""
    calls = []

    def counting(path, coordinates, spans, chunks, processes):
        calls.append(sum(len(chunk) for chunk in chunks.values()))
        yield from workers.analyse_chunks(path, coordinates, spans, chunks, processes)

    monkeypatch.setattr(muscle_analysis, "analyse_chunks", counting)
    monkeypatch.setattr(muscle_analysis, "CHUNK", 4)
    return calls


def analyse(model, knee, muscles=("extensor", "flexor")):
    return analyse_muscles(model, muscles, ["knee"], np.asarray(knee)[:, None], processes=1, quiet=True)


def test_results_for_the_same_inputs_are_cached(empty_cache, counted, odd_model):
    knee = np.linspace(0.1, 1.0, 10)
    first, second = analyse(odd_model, knee), analyse(odd_model, knee)
    assert counted == [10]
    np.testing.assert_array_equal(first.length, second.length)
    np.testing.assert_array_equal(first.moment_arm, second.moment_arm)
    assert second.muscles == ("extensor", "flexor") and second.coordinates == ("knee",)


def test_results_for_other_inputs_are_not_cached(empty_cache, counted, odd_model, tmp_path):
    knee, model = np.linspace(0.1, 1.0, 4), tmp_path / "model.osim"
    model.write_bytes(odd_model.read_bytes())
    thin = analyse(model, knee)
    analyse(model, knee + 1e-15 * (knee > 0.5))
    analyse(model, knee, muscles=("flexor", "extensor"))
    model.write_text(odd_model.read_text().replace("<radius>0.0299", "<radius>0.0309"))
    thick = analyse(model, knee)
    assert counted == [4, 4, 4, 4]
    assert np.abs(thick.length - thin.length).max() > 1e-5
    # The model's folder does not matter.
    np.testing.assert_array_equal(analyse(odd_model, knee).length, thin.length)
    assert counted == [4, 4, 4, 4]


@pytest.mark.parametrize("damage", [b"", b"rubbish", None], ids=["empty", "rubbish", "cut"])
def test_a_damaged_cache_file_is_recomputed(empty_cache, counted, odd_model, damage):
    knee = np.linspace(0.1, 1.0, 10)
    expected = analyse(odd_model, knee)
    cached = sorted(empty_cache.glob("*.npz"))[0]
    cached.write_bytes(cached.read_bytes()[:300] if damage is None else damage)
    found = analyse(odd_model, knee)
    assert len(counted) == 2 and counted[1] in (2, 4)
    np.testing.assert_array_equal(found.length, expected.length)
    np.testing.assert_array_equal(found.moment_arm, expected.moment_arm)
    analyse(odd_model, knee)
    assert len(counted) == 2


def after_the_first_chunk(monkeypatch, action):
    """Call a function once the first chunk has been cached; return a function that undoes this."""
    write_arrays = Store.write_arrays

    def then(*arguments, **arrays):
        write_arrays(*arguments, **arrays)
        action()

    monkeypatch.setattr(Store, "write_arrays", then)
    return lambda: monkeypatch.setattr(Store, "write_arrays", write_arrays)


def test_interrupted_work_leaves_no_process_and_is_continued(empty_cache, counted, monkeypatch, odd_model):
    def interrupt():
        raise KeyboardInterrupt

    knee = np.linspace(0.1, 1.0, 40)[:, None]
    restore = after_the_first_chunk(monkeypatch, interrupt)
    with pytest.raises(KeyboardInterrupt):
        analyse_muscles(odd_model, ["flexor"], ["knee"], knee, processes=2, quiet=True)
    assert multiprocessing.active_children() == []
    assert [file.suffix for file in empty_cache.iterdir()] == [".npz"]
    restore()
    analyse_muscles(odd_model, ["flexor"], ["knee"], knee, processes=1, quiet=True)
    assert counted == [40, 36]


def test_a_worker_that_dies_is_reported_and_finished_results_are_kept(
    empty_cache, counted, monkeypatch, odd_model
):
    def kill():
        for child in multiprocessing.active_children():
            child.kill()

    # Enough chunks for some to remain when the first one is done.
    knee = np.linspace(0.1, 1.0, 4000)[:, None]
    restore = after_the_first_chunk(monkeypatch, kill)
    with pytest.raises(RuntimeError, match="worker process of the muscle analysis died"):
        analyse_muscles(odd_model, ["flexor"], ["knee"], knee, processes=2, quiet=True)
    assert multiprocessing.active_children() == []
    restore()
    cached = len(list(empty_cache.glob("*.npz")))
    assert cached >= 1
    analyse_muscles(odd_model, ["flexor"], ["knee"], knee, processes=1, quiet=True)
    assert counted == [4000, 4000 - 4 * cached]


SCRIPT = """
import numpy as np, os, signal
from wrapjax.io.store import Store
from wrapjax.osim.muscle_analysis import analyse_muscles

# Interrupts are ignored if the tests run in the background of a shell.
signal.signal(signal.SIGINT, signal.default_int_handler)

def action(*arguments, **arrays):
    {action}

Store.write_arrays = action
poses = np.linspace(0.0, 1.0, 50_000)[:, None]
found = analyse_muscles({model!r}, ["flexor"], ["knee"], poses, processes=2, quiet=True)
print(found.length.shape)
"""


def run_script(folder, model, action):
    """Run a script that executes a statement whenever a chunk is done.

    Its workers share its standard output, so that this function returns when the last of them has ended.
    """
    (folder / "script.py").write_text(SCRIPT.format(model=str(model), action=action))
    return subprocess.run(
        [sys.executable, folder / "script.py"], capture_output=True, text=True, check=False, timeout=60
    )


def test_a_script_without_main_guard_runs_once(empty_cache, tmp_path, odd_model):
    finished = run_script(tmp_path, odd_model, "pass")
    assert (finished.stdout, finished.stderr, finished.returncode) == ("(50000, 1)\n", "", 0)


@pytest.mark.parametrize(
    ("action", "ending"),
    [
        ("os.kill(os.getpid(), signal.SIGINT)", -signal.SIGINT),
        # Twice, the second time while the workers end.
        (
            "import threading; threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGINT)).start();"
            "os.kill(os.getpid(), signal.SIGINT)",
            -signal.SIGINT,
        ),
        ("os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL),
    ],
    ids=["interrupted", "interrupted-twice", "killed"],
)
def test_workers_end_with_their_parent(empty_cache, tmp_path, odd_model, action, ending):
    finished = run_script(tmp_path, odd_model, action)
    assert finished.stdout == "" and finished.returncode == ending


def test_a_cache_that_cannot_be_written_is_no_error(empty_cache, monkeypatch, odd_model):
    def full(path, write):
        raise OSError("no space left on device")

    monkeypatch.setattr("wrapjax.io.store.write_atomically", full)
    assert np.isfinite(analyse(odd_model, [0.5]).length).all()
    assert list(empty_cache.iterdir()) == []


def problems_of(*arguments):
    with pytest.raises(InputError) as caught:
        analyse_muscles(*arguments, quiet=True)
    return caught.value.problems


def test_unknown_names_are_all_reported_with_the_nearest(odd_model):
    problems = problems_of(odd_model, ["flexr", "flexor"], ["knees", "hip"], np.zeros((1, 2)))
    assert [(p.file, p.place, p.hint) for p in problems] == [
        (str(odd_model), "flexr", "did you mean 'flexor'?"),
        (str(odd_model), "knees", "did you mean 'knee'?"),
    ]


def test_names_are_checked_without_poses_too(odd_model):
    assert len(problems_of(odd_model, ["flexr"], ["knee"], np.zeros((0, 1)))) == 1
    nothing = analyse_muscles(odd_model, ["flexor"], ["knee"], np.zeros((0, 1)), quiet=True)
    assert nothing.length.shape == (0, 1) and nothing.moment_arm.shape == (0, 1, 1)


def test_coordinates_that_cannot_be_set_are_errors(odd_model):
    followed, locked = problems_of(odd_model, ["flexor"], ["patella_turn", "toe"], np.array([[0.1, 0.3]]))
    assert followed.place == "patella_turn" and "follows knee" in followed.message
    assert locked.place == "toe" and "locked at 0.1 in the model, but a pose has it at 0.3" in locked.message


def test_a_locked_coordinate_may_be_given_at_its_locked_value(odd_model):
    pose = np.array([[0.6, 0.1]])
    with_toe = analyse_muscles(odd_model, ["toe_flexor"], ["knee", "toe"], pose, quiet=True)
    assert with_toe.moment_arm.tolist() == [[[0.0], [0.0]]]


def test_poses_that_are_not_finite_are_errors(odd_model):
    poses = np.array([[0.1, 0.2], [np.nan, 0.2], [np.nan, np.inf]])
    hip, knee = problems_of(odd_model, ["flexor"], ["hip", "knee"], poses)
    assert (hip.place, hip.message) == ("hip", "is nan in pose 1")
    assert (knee.place, knee.message) == ("knee", "is inf in pose 2")


def test_poses_with_a_wrong_number_of_coordinates_are_an_error(odd_model):
    with pytest.raises(ValueError, match="do not fit 1 coordinates"):
        analyse_muscles(odd_model, ["flexor"], ["knee"], np.zeros((3, 2)), quiet=True)


def test_an_unsupported_constraint_is_an_error(tmp_path, odd_model):
    model, _ = load_model(odd_model)
    tie = opensim.PointConstraint(
        model.getGround(), opensim.Vec3(0), model.getBodySet().get("foot"), opensim.Vec3(0)
    )
    tie.setName("tie")
    model.addConstraint(tie)
    model.finalizeConnections()
    model.printToXML(str(tmp_path / "model.osim"))
    (problem,) = problems_of(tmp_path / "model.osim", ["flexor"], ["knee"], np.zeros((1, 1)))
    assert problem.place == "tie" and "is a PointConstraint" in problem.message
    tie.set_isEnforced(False)
    model.printToXML(str(tmp_path / "model.osim"))
    assert describe_model(tmp_path / "model.osim").uncommon_parts[3:] == ()
    analyse_muscles(tmp_path / "model.osim", ["flexor"], ["knee"], np.zeros((1, 1)), quiet=True)
