"""The four gates: each passes where a claim is right, and fails where one thing is wrong with it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.noise import noise_of_width
from wrapjax.diagnosis.claims.gates import (
    Claim,
    Recorded,
    adequacy,
    adequacy_of_plain_model,
    examine,
    moment_accuracy,
    part_scores,
    plausibility,
    recording_parts,
    specificity,
    stability,
)
from wrapjax.diagnosis.claims.residual_fit import ResidualModel, UnseenCycles, repeatable_rms
from wrapjax.diagnosis.claims.sham_effects import scaled_like, sham_effects
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.evidence.score import score
from wrapjax.diagnosis.null_hypotheses.error_sources import MuscleErrors

CYCLES, COORDINATES, PHASES = 8, 2, 25
SHAPE = (CYCLES, COORDINATES, PHASES)
SPEEDS = np.repeat([0, 1], CYCLES // 2)
NOISE = noise_of_width(np.array([[1.0, 0.2], [0.2, 1.0]]), 0.05)
PHASE = 2.0 * np.pi * np.arange(PHASES) / PHASES
MOMENT_SD = np.array([20.0, 20.0])


def of_every_cycle(first, second):
    return np.broadcast_to(np.stack([first, second]), SHAPE)


#: A wave at the first coordinate, another one at the second, and one that no effect has.
WAVE, OTHER = of_every_cycle(np.sin(PHASE), 0 * PHASE), of_every_cycle(0 * PHASE, np.cos(2 * PHASE))
STRANGE = of_every_cycle(np.sin(5 * PHASE), np.sin(4 * PHASE))


def candidate(id, signature):
    return Candidate(id, (signature.reshape(1, -1),), np.array([3.0]), np.array([False]))


@pytest.fixture
def generator():
    return np.random.default_rng(3)


def noise(generator, samples=1):
    root = np.linalg.cholesky(NOISE.block(PHASES))
    return (generator.normal(size=(samples, CYCLES, COORDINATES * PHASES)) @ root.T).reshape(samples, *SHAPE)


def model_with(generator, signal):
    residual = signal + noise(generator)[0]
    return LinearizedModel(
        residual=residual,
        fitted_residual=residual,
        slopes=generator.normal(size=(3, *SHAPE)) * 0.1,
        prior_root=np.eye(3),
        from_prior_mean=np.zeros(3),
        nuisances=generator.normal(size=(1, *SHAPE)) * 0.1,
        candidates=(candidate("cop_offset", WAVE), candidate("joint_damping", OTHER)),
        input_errors=(),
        muscle_errors=MuscleErrors(
            generator.normal(size=(2, CYCLES, PHASES, 3)), generator.normal(size=(2, *SHAPE))
        ),
        speeds=SPEEDS,
        known_noise=NOISE,
    )


def recorded():
    angles = np.broadcast_to(np.stack([np.sin(PHASE), np.cos(PHASE)]), SHAPE)
    blocks = tuple(np.array([cycle, cycle + 4]) for cycle in range(4))
    return Recorded(angles, np.roll(angles, 3, axis=-1), blocks, MOMENT_SD)


def test_adequate_unless_more_repeats_than_in_replicates(generator):
    replicates = noise(generator, 40).reshape(40, -1)

    def adequate(signal):
        linearized = model_with(generator, signal)
        return adequacy(ResidualModel.of(linearized), linearized, replicates, 3.0 * WAVE[None])

    assert adequate(5.0 * WAVE).passed
    assert not adequate(5.0 * WAVE + 3.0 * STRANGE).passed


def test_an_error_below_the_accuracy_of_the_moments_is_adequate(generator):
    """Recordings with little noise have replicates that leave next to nothing."""
    replicates = noise(generator, 40).reshape(40, -1)
    linearized = model_with(generator, 3.0 * STRANGE)

    def adequate(accuracy):
        model = ResidualModel.of(linearized)
        return adequacy(model, linearized, replicates, linearized.nuisances[:0], accuracy=accuracy)

    plain = adequate(0.0)
    assert not plain.passed and adequate(1.01 * plain.left_rms).passed
    assert not adequate(0.99 * plain.left_rms).passed
    assert adequate(0.1 * plain.floor_rms) == plain
    assert moment_accuracy(np.array([30.0, 40.0])) == pytest.approx(0.04 * np.sqrt(1250.0))


def test_the_strongest_of_a_tie_is_fitted_and_all_of_a_joint_claim(generator):
    signal = 5.0 * WAVE + 5.0 * OTHER
    linearized = model_with(generator, signal)
    replicates = noise(generator, 40).reshape(40, -1)
    scores = score(linearized, MOMENT_SD, replicates[:3], 5.0)

    def examined(together):
        claim = Claim(together, ("cop_offset", "joint_damping"))
        return examine(linearized, scores, replicates, recorded(), claim, 1.0)

    assert not examined(("cop_offset",)).adequate.passed
    assert examined(("cop_offset", "joint_damping")).adequate.passed
    plain = adequacy_of_plain_model(linearized, replicates, MOMENT_SD, 1.0)
    assert plain.left_rms > examined(("cop_offset",)).adequate.left_rms > plain.floor_rms
    assert plain.relative == plain.left_rms / plain.floor_rms


def test_plausible_within_the_limits_only():
    within = plausibility([("shift", 0.01, 0.05, "m"), ("mass", -0.1, 0.3, "1")])
    assert within.passed and within.name == "mass"
    assert not plausibility([("shift", 0.01, 0.05, "m"), ("mass", -0.3, 0.3, "1")]).passed
    assert plausibility([]).passed


def stable(linearized, any_of, threshold=3.0):
    return stability(part_scores(linearized, MOMENT_SD), any_of, threshold)


def test_stable_where_all_parts_agree(generator):
    right = stable(model_with(generator, 6.0 * WAVE + 2.0 * OTHER), ["cop_offset"])
    # Without the first coordinate the effect cannot show: no witness against it.
    assert "without coordinate 1" not in right.first and "without coordinate 2" in right.first
    assert right.agreement == 1.0 and right.passed and right.leaders == ("cop_offset",)
    first_speed = np.where(SPEEDS == 0, 1.0, 0.0)[:, None, None]
    signal = 5.0 * WAVE * first_speed + 9.0 * OTHER * (1.0 - first_speed)
    linearized = model_with(generator, signal)
    mixed = stable(linearized, ["cop_offset"])
    assert mixed.first["speed 1"] == "cop_offset" and mixed.first["speed 2"] == "joint_damping"
    assert not mixed.passed
    assert stable(linearized, ["cop_offset", "joint_damping"]).passed
    # What no part shows beyond the threshold contradicts nothing, and confirms nothing.
    silent = stable(model_with(generator, 0.0 * WAVE), ["cop_offset"], 1e3)
    assert set(silent.first.values()) <= {"cop_offset"}


def test_parts_of_a_short_recording_leave_out_one_cycle_each(generator):
    linearized = model_with(generator, WAVE)
    short = linearized.restricted(np.array([0, 1, 4, 5]), np.arange(COORDINATES))
    names = list(recording_parts(short))
    assert [name for name in names if name.startswith("without cycle")] == [
        f"without cycle {cycle}" for cycle in (1, 2, 3, 4)
    ]
    assert {"odd cycles", "even cycles", "speed 1", "speed 2"} <= set(recording_parts(linearized))


def test_specific_where_the_error_has_the_shape_of_the_effect(generator):
    def specific(signal, effect):
        linearized = model_with(generator, signal)
        model = ResidualModel.of(linearized)
        return specificity(model, linearized, recorded(), 3.0 * effect[None])

    right = specific(5.0 * WAVE, WAVE)
    assert right.passed and right.shrinkage > 0.5
    assert not specific(5.0 * WAVE, OTHER).passed


def test_effects_of_single_cycles_are_not_held_to_unseen_cycles(generator):
    linearized = model_with(generator, 5.0 * WAVE)
    model = ResidualModel.of(linearized)
    each = np.eye(CYCLES)[:, :, None, None] * WAVE[None]
    assert specificity(model, linearized, recorded(), each) is None
    shifts = Candidate(
        "event_jitter", (each.reshape(len(each), -1),), np.full(len(each), 3.0), np.full(len(each), False)
    )
    scores = score(
        replace(linearized, candidates=(*linearized.candidates, shifts)),
        MOMENT_SD,
        np.zeros((0, each[0].size)),
        0.0,
    )
    assert scores.of_single_cycles == ("event_jitter",)
    assert specificity(model, linearized, recorded(), each[:2] + each[2:4]) is not None


def test_a_restricted_model_is_that_of_the_chosen_rows(generator):
    linearized = model_with(generator, WAVE)
    cycles, coordinates = np.array([1, 6]), np.array([1])
    part = linearized.restricted(cycles, coordinates)
    np.testing.assert_array_equal(part.residual, linearized.residual[cycles][:, coordinates])
    (signature,) = part.candidates[1].variants
    np.testing.assert_array_equal(signature.reshape(2, 1, PHASES), OTHER[cycles][:, coordinates])
    assert part.noise.between.shape == (1, 1)
    np.testing.assert_array_equal(part.speeds, SPEEDS[cycles])


def test_errors_of_unseen_cycles_are_those_of_explicit_fits(generator):
    linearized = model_with(generator, 2.0 * WAVE)
    model = ResidualModel.of(linearized)
    residual = model.whitened(linearized.residual[None])[..., 0]
    further = model.whitened(3.0 * WAVE[None])
    block = np.array([0, 4])
    (error,) = UnseenCycles(model.columns, residual, [block]).errors([further])
    columns = np.concatenate([model.columns, further], axis=2)
    seen = np.setdiff1d(np.arange(CYCLES), block)
    rows, target = columns[seen].reshape(-1, 5), residual[seen].ravel()
    mean = np.linalg.solve(rows.T @ rows + np.eye(5), rows.T @ target)
    left = residual[block] - columns[block] @ mean
    assert error == pytest.approx(np.mean(left**2), rel=1e-10)


def test_the_fit_subtracts_what_parameters_predict(generator):
    linearized = model_with(generator, 4.0 * WAVE)
    model = ResidualModel.of(linearized).adding(100.0 * WAVE[None])
    left = model.fit(linearized.residual[None])
    before, after = (repeatable_rms(one, SPEEDS)[0] for one in (linearized.residual[None], left))
    assert after < 0.4 * before
    assert abs(np.vdot(left.mean(axis=(0, 1)), WAVE[0])) < 2.0


def test_shams_are_as_large_as_the_effect_and_differ(generator):
    linearized = model_with(generator, WAVE)
    model, of = ResidualModel.of(linearized), recorded()
    shams = sham_effects(2, of.angles, of.velocities, linearized.muscle_errors.arms, count=10)
    assert all(one.shape == (2, *SHAPE) for one in shams)
    wanted = np.stack([WAVE, OTHER])
    for one in shams:
        size = np.linalg.norm(model.whitened(scaled_like(one, wanted, model)))
        assert size == pytest.approx(np.linalg.norm(model.whitened(wanted)))
    again = sham_effects(2, of.angles, of.velocities, linearized.muscle_errors.arms, count=10)
    np.testing.assert_array_equal(np.stack(shams), np.stack(again))


def test_noise_estimated_elsewhere_is_kept(generator):
    linearized = replace(model_with(generator, WAVE), known_noise=None)
    assert linearized.restricted(np.arange(4), np.arange(2)).noise is not linearized.noise
    np.testing.assert_array_equal(
        linearized.restricted(np.arange(4), np.arange(2)).noise.between, linearized.noise.between
    )
