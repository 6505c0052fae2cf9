"""Muscles without EMG in every null; uncertain moment arms."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.subject import CURVES, small_recording_and_context
from wrapjax.diagnosis.effects.unrecorded_excitation import SPLINES
from wrapjax.diagnosis.inputs.priors import MOMENT_ARM_SD
from wrapjax.diagnosis.null_hypotheses.error_sources import moment_arm_errors
from wrapjax.diagnosis.null_hypotheses.undriven_capacity import (
    UNRECORDED_SHARE,
    CapacityShare,
    undriven_capacity,
    undriven_signatures,
    unrecorded_moment_signatures,
)
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.model.forward import joint_moments

FRAMES = np.arange(20)


@pytest.fixture
def leg():
    return small_recording_and_context()


def with_strength(context, factor):
    others = context.undriven_muscles
    force = factor * others.parameters.max_isometric_force
    return replace(
        context,
        undriven_muscles=eqx.tree_at(lambda tree: tree.parameters.max_isometric_force, others, force),
    )


def test_the_share_is_that_of_force_times_arm(leg):
    _, context = leg
    found = undriven_capacity(context)
    others = context.undriven_muscles
    of_others = np.maximum(np.asarray(others.path.moment_arm)[:, :, 0], 0.0).mean(axis=(1, 2))
    flexors = float(of_others @ np.asarray(others.parameters.max_isometric_force))
    arms = np.maximum(np.asarray(context.paths.moment_arm)[:, :, 0], 0.0).mean(axis=(1, 2))
    driven = float(arms @ np.asarray(context.parameters.max_isometric_force))
    assert found["hip_flexion_l"].positive == pytest.approx(flexors / (flexors + driven))
    assert found["hip_flexion_l"].negative == 0.0 and found["knee_angle_l"] == CapacityShare(0.0, 0.0, 0.0)
    nobody = undriven_capacity(replace(context, undriven_muscles=None))
    assert set(nobody.values()) == {CapacityShare(0.0, 0.0, 0.0)}


def test_a_direction_that_is_mostly_recorded_adds_nothing_to_the_null(leg):
    _, context = leg
    assert undriven_signatures(with_strength(context, 0.05), FRAMES).shape == (0, 4, 3, 20)
    assert undriven_signatures(replace(context, undriven_muscles=None), FRAMES).shape == (0, 4, 3, 20)


def test_a_direction_without_emg_is_uncertain(leg):
    _, context = leg
    others = [with_strength(context, factor) for factor in (20.0, 200.0)]
    assert min(undriven_capacity(one)["hip_flexion_l"].positive for one in others) > UNRECORDED_SHARE
    weak, strong = (undriven_signatures(one, FRAMES) for one in others)
    assert weak.shape == strong.shape == (SPLINES, 4, 3, 20), "both muscles share one excitation"
    np.testing.assert_allclose(strong, 10.0 * weak, rtol=1e-6)
    np.testing.assert_array_equal(strong[:, :, 1:], 0.0)


def test_the_moment_of_a_coordinate_without_emg_is_uncertain_as_a_whole(leg):
    _, context = leg
    measured = np.random.default_rng(1).normal(size=(4, 3, 20))
    speeds = np.array([0, 0, 1, 1])
    few = unrecorded_moment_signatures(with_strength(context, 0.05), measured, speeds)
    assert few.shape == (0, 4, 3, 20)
    strong = with_strength(context, 1e3)
    shares = undriven_capacity(strong)
    places = [place for place, share in enumerate(shares.values()) if not share.has_emg_for_most]
    assert places == [0], "the muscles without EMG act at the hip"
    found = unrecorded_moment_signatures(strong, measured, speeds)
    covariance = np.einsum("pcqf,pdqg->qcfdg", found, found)
    np.testing.assert_array_equal(covariance[1:], 0.0)
    variance = np.einsum("cfcf->cf", covariance[0])
    np.testing.assert_allclose(variance, np.mean(measured[:, 0] ** 2), rtol=0.02)
    np.testing.assert_allclose(covariance[0, 0, :, 1], covariance[0, 0, :, 0], rtol=1e-12)
    np.testing.assert_array_equal(covariance[0, 0, :, 2], 0.0)


def test_errors_of_moment_arms_are_those_of_changed_paths(leg):
    recording, context = leg
    found = moment_arm_errors(CURVES, context.parameters, recording, context, FRAMES)
    path = context.paths
    crossed = np.argwhere((np.abs(np.asarray(path.moment_arm)).max(axis=(1, 3)) > 0.002).T)
    assert len(found) == len(crossed)
    place = [tuple(pair) for pair in crossed].index((2, 0))
    h = 1e-6
    angle, velocity = jnp.asarray(context.angles[:, 2]), jnp.asarray(context.velocities[:, 2])

    def moments(change):
        moved = PathState(
            jnp.asarray(path.length).at[0].add(-change * (angle - angle.mean())),
            jnp.asarray(path.velocity).at[0].add(-change * velocity),
            jnp.asarray(path.moment_arm).at[0, :, 2].add(change),
        )
        return joint_moments(CURVES, context.parameters, replace(recording, path=fixed_path(moved)))

    difference = np.asarray(moments(h) - moments(-h)) / (2.0 * h)
    np.testing.assert_allclose(found[place], MOMENT_ARM_SD * difference[..., FRAMES], rtol=1e-5, atol=1e-8)
