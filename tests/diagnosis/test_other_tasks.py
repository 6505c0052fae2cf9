"""Defends: effects of the phase of gait are absent from other tasks, where no phase exists."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.subject import CURVES, FRAMES, small_recording_and_context
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.effects.periodic import with_padding
from wrapjax.diagnosis.fits.prediction import predicted_moments
from wrapjax.diagnosis.null_hypotheses.undriven_capacity import undriven_signatures
from wrapjax.diagnosis.protocol.context import joined
from wrapjax.diagnosis.protocol.paths import sped_up

RECORDING, CONTEXT = small_recording_and_context()
#: The last two cycles as if they were other trials.
MIXED = dataclasses.replace(CONTEXT, tasks=("gait", "gait", "passive", "isometric"))
GAIT = np.array([True, True, False, False])


def change(id: str, context, size: float = 0.3) -> np.ndarray:
    """Change of the moments by an effect of which all sizes are the same, N m."""
    effect = CATALOGUE[id].build(context)
    effects = Effects((effect,))
    sizes = jnp.full(effects.count, size)
    plain, altered = (
        np.asarray(predicted_moments(CURVES, context.parameters, RECORDING, effects, vector))
        for vector in (effects.zero, sizes)
    )
    return altered - plain


def test_cycles_are_gait_unless_told_otherwise():
    assert CONTEXT.is_gait.all() and CONTEXT.gait_cycles == CONTEXT.trials
    np.testing.assert_array_equal(MIXED.is_gait, GAIT)
    assert MIXED.select([1, 2]).tasks == ("gait", "passive")


def test_conditions_are_of_gait_alone():
    """A passive trial is no condition in which an offset could be present alone."""
    assert list(CONTEXT.conditions) == ["in slow only", "in fast only"]
    ramps = dataclasses.replace(MIXED, tasks=("gait", "gait", "isometric", "isometric"))
    assert ramps.conditions == {}


def test_an_unrecorded_drive_of_gait_is_none_elsewhere():
    found = change("missing_drive", MIXED)
    assert np.abs(found[GAIT]).max() > 1.0
    np.testing.assert_array_equal(found[~GAIT], 0.0)


def test_only_gait_cycles_can_be_shifted_against_each_other():
    names = [entry.name for entry in CATALOGUE["event_jitter"].build(MIXED).parameters]
    assert names == ["shift_slow/01", "shift_slow/02"]


def test_a_delay_by_speed_does_not_touch_other_tasks():
    """Their speed is not known, and the requirement of known speeds is of gait."""
    unknown = dataclasses.replace(
        MIXED, speeds=np.array([0.5, 0.8, np.nan, np.nan]), order=np.linspace(0.0, 1.0, 4)
    )
    found = change("speed_dependent_delay", unknown, 0.02)
    assert np.isfinite(found).all() and np.abs(found[GAIT]).max() > 0.0
    np.testing.assert_allclose(found[~GAIT], 0.0, atol=1e-12)


def test_muscles_without_emg_rest_in_passive_trials_and_are_unknown_in_others():
    frames = np.arange(0, FRAMES - 1, 2)
    mixed, gait = (undriven_signatures(context, frames) for context in (MIXED, CONTEXT))
    assert len(mixed) == 2 * len(gait) > 0
    np.testing.assert_array_equal(mixed[:, 2], 0.0)
    of_gait, of_ramp = (np.abs(mixed[:, cycle]).max(axis=(1, 2)) > 0.0 for cycle in (0, 3))
    assert not (of_gait & of_ramp).any() and of_gait.any() and of_ramp.any()


def test_signals_cover_the_emg_before_and_after_each_cycle():
    """More EMG precedes a window than follows it; gait repeats itself there, other movements are held."""
    frames, before, after = CONTEXT.angles.shape[-1], 7, 3
    knots = frames + before + after
    envelopes = jnp.zeros((*CONTEXT.envelopes.shape[:3], knots - 1))
    context = dataclasses.replace(MIXED, envelopes=envelopes, padding=before)
    values = jnp.asarray(np.random.default_rng(0).normal(size=(2, 4, frames)))
    padded = np.asarray(with_padding(values, context))
    assert padded.shape[-1] == knots
    np.testing.assert_array_equal(padded[..., before : before + frames - 1], values[..., :-1])
    np.testing.assert_array_equal(padded[:, :2, before - 1], values[:, :2, -2])
    np.testing.assert_array_equal(padded[:, 2:, :before], np.repeat(values[:, 2:, :1], before, axis=-1))
    np.testing.assert_array_equal(padded[:, 2:, -after:], np.repeat(values[:, 2:, -1:], after, axis=-1))


@pytest.fixture(scope="module")
def together():
    return joined([(RECORDING, CONTEXT), (RECORDING, dataclasses.replace(MIXED, measured_changes={}))])


def test_joined_cycles_keep_their_paths_and_changes(together):
    recording, context = together
    assert len(context.trials) == 8 and context.tasks[:4] == ("gait",) * 4
    np.testing.assert_array_equal(context.is_gait, [*[True] * 4, *GAIT])
    length = np.asarray(recording.path.nominal.length)
    np.testing.assert_array_equal(length[:, :4], length[:, 4:])
    sizes = 1e-3 * jnp.ones(CONTEXT.wraps.places.shape)
    of_all, of_first = (np.asarray(one.wraps.by_muscle(sizes).length) for one in (context, CONTEXT))
    np.testing.assert_allclose(of_all, np.concatenate([of_first, of_first], axis=1))


def test_errors_of_force_plates_change_nothing_in_appended_cycles(together):
    _, context = together
    for id, variants in context.measured_changes.items():
        for label, function in variants.items():
            sizes = jnp.ones(len(CATALOGUE[id].parameters_of(context)))
            changed = np.asarray(function(sizes))
            np.testing.assert_array_equal(changed[4:], 0.0)
            np.testing.assert_array_equal(changed[:4], CONTEXT.measured_changes[id][label](sizes))


def test_the_same_motion_in_less_time_is_faster_alone():
    faster = sped_up(CONTEXT.paths, 1.3)
    np.testing.assert_array_equal(faster.length, CONTEXT.paths.length)
    np.testing.assert_allclose(faster.velocity, 1.3 * CONTEXT.paths.velocity)
