"""Effects of one recording or walking speed, and of exchanged or lost channels."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.subject import EXCHANGED, MUSCLE_CHANNELS, small_recording_and_context
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.effect import Effect

RECORDING, CONTEXT = small_recording_and_context(EXCHANGED)
CHANNEL_OF = np.array(MUSCLE_CHANNELS)
SLOW = np.array([True, True, False, False])


def emg_after(
    id: str, label: str, sizes: dict[str, float], recording=RECORDING, context=CONTEXT
) -> np.ndarray:
    """Apply an effect to the EMG; return the coefficients of the muscles' envelopes."""
    effect = CATALOGUE[id].build(context)
    vector = np.array([sizes.get(entry.name, 0.0) for entry in effect.parameters])
    assert set(sizes) <= {entry.name for entry in effect.parameters}
    (variant,) = (one for one in effect.variants if one.label == label)
    return np.asarray(variant.alteration(jnp.asarray(vector)).emg(recording.emg).coefficients)


def test_conditions_are_recordings_and_speeds_of_several_cycles():
    found = CONTEXT.conditions
    assert list(found) == ["in slow only", "in fast only"]
    np.testing.assert_array_equal(found["in slow only"], SLOW)
    one = dataclasses.replace(CONTEXT, recordings=("slow", "slow", "a", "b"))
    assert list(one.conditions) == ["in slow only", "at 0.80 m/s only"]
    mixed = dataclasses.replace(CONTEXT, recordings=("a", "b", "a", "b"))
    assert list(mixed.conditions) == ["in a only", "in b only", "at 0.50 m/s only", "at 0.80 m/s only"]
    held_out = dataclasses.replace(CONTEXT, uses=("calibration",) * 3 + ("validation",))
    assert list(held_out.conditions) == ["in slow only"]
    same = dataclasses.replace(CONTEXT, recordings=("a",) * 4, speeds=np.full(4, np.nan))
    assert same.conditions == {}


def test_a_selection_has_the_conditions_of_all_cycles():
    """Otherwise the variants of an effect would differ between the cycles that are fitted and predicted."""
    chosen = CONTEXT.select([1, 3])
    assert list(chosen.conditions) == list(CONTEXT.conditions)
    np.testing.assert_array_equal(chosen.conditions["in slow only"], [True, False])
    for id in ("emg_offset", "emg_drift", "cop_offset"):
        labels = [[one.label for one in CATALOGUE[id].build(of).variants] for of in (CONTEXT, chosen)]
        assert labels[0] == labels[1]


def test_offset_of_one_recording_is_that_of_all_there_and_none_elsewhere():
    everywhere, slow = (
        emg_after("emg_offset", label, {"offset_Gas": 0.05}) for label in ("", "in slow only")
    )
    plain = np.asarray(RECORDING.emg.coefficients)
    np.testing.assert_array_equal(slow[:, SLOW], everywhere[:, SLOW])
    np.testing.assert_array_equal(slow[:, ~SLOW], plain[:, ~SLOW])
    np.testing.assert_allclose(plain - everywhere, 0.05 * _constant(plain, CHANNEL_OF == 1), atol=1e-15)


def _constant(coefficients: np.ndarray, muscles: np.ndarray) -> np.ndarray:
    ones = np.zeros_like(coefficients)
    ones[muscles, :, 3] = 1.0
    return ones


def test_gain_of_one_recording_differs_from_the_others_and_has_mean_one():
    found = emg_after("emg_drift", "in fast only", {"gain_change_Sol": 0.5})
    gain = np.asarray(RECORDING.emg.coefficients)[0] / found[0]
    assert gain[2:].mean() / gain[:2].mean() == pytest.approx(1.5)
    # A recorded gain that has been divided by its mean over all cycles.
    assert gain[[0, 2]].mean(axis=(1, 2)).mean() == pytest.approx(1.0)
    np.testing.assert_array_equal(found[1:], RECORDING.emg.coefficients[1:])


def test_exchanging_channels_twice_gives_the_recorded_envelopes():
    swapped = emg_after("emg_channel_swap", "", {"Sol_with_TibAnt": 1.0})
    plain = np.asarray(RECORDING.emg.coefficients)
    np.testing.assert_allclose(swapped[0], plain[3], atol=1e-15)
    np.testing.assert_allclose(swapped[3], plain[0], atol=1e-15)
    np.testing.assert_array_equal(swapped[[1, 2, 4, 5]], plain[[1, 2, 4, 5]])
    exchanged = dataclasses.replace(
        RECORDING, emg=dataclasses.replace(RECORDING.emg, coefficients=jnp.asarray(swapped))
    )
    np.testing.assert_allclose(
        emg_after("emg_channel_swap", "", {"Sol_with_TibAnt": 1.0}, exchanged), plain, atol=1e-15
    )
    pairs = [entry.name for entry in CATALOGUE["emg_channel_swap"].build(CONTEXT).parameters]
    assert pairs == ["Sol_with_TibAnt"]
    restored = dataclasses.replace(CONTEXT, envelopes=jnp.asarray(swapped))
    for other in (restored, dataclasses.replace(CONTEXT, tasks=("isometric",) * len(CONTEXT.trials))):
        assert "usual phases" in CATALOGUE["emg_channel_swap"].build(other).reason


def test_a_channel_lost_in_one_recording_gets_the_mean_envelope_of_the_other():
    plain = np.asarray(RECORDING.emg.coefficients)
    lost = plain.copy()
    lost[0, SLOW] = 0.0
    recorded = dataclasses.replace(
        RECORDING, emg=dataclasses.replace(RECORDING.emg, coefficients=jnp.asarray(lost))
    )
    context = dataclasses.replace(CONTEXT, envelopes=jnp.asarray(lost))
    effect = CATALOGUE["emg_channel_loss"].build(context)
    assert [entry.name for entry in effect.parameters] == ["lost_Sol"]
    labels = [one.label for one in CATALOGUE["emg_channel_loss"].build(context.select([1, 2])).variants]
    assert labels == [one.label for one in effect.variants]
    found = emg_after("emg_channel_loss", "in slow only", {"lost_Sol": 1.0}, recorded, context)
    for cycle in (0, 1):
        np.testing.assert_allclose(found[0, cycle], plain[0, 2:].mean(axis=0), atol=1e-15)
    np.testing.assert_array_equal(found[0, 2:], plain[0, 2:])
    np.testing.assert_array_equal(found[1:], plain[1:])


def test_a_smaller_gain_is_no_lost_channel():
    plain = np.asarray(RECORDING.emg.coefficients)
    for factor, testable in ((0.5, False), (0.05, True)):
        weaker = np.where(SLOW[:, None, None] & (CHANNEL_OF == 0)[:, None, None, None], factor, 1.0) * plain
        found = CATALOGUE["emg_channel_loss"].build(
            dataclasses.replace(CONTEXT, envelopes=jnp.asarray(weaker))
        )
        assert isinstance(found, Effect) == testable


def test_an_error_of_one_plate_changes_the_moments_of_its_recording_only():
    effect = CATALOGUE["cop_offset"].build(CONTEXT)
    sizes = jnp.array([0.01, -0.02])
    everywhere, slow, fast = (np.asarray(one.alteration(sizes).moment) for one in effect.variants)
    np.testing.assert_array_equal(slow[SLOW], everywhere[SLOW])
    np.testing.assert_array_equal(slow + fast, everywhere)
    assert not slow[~SLOW].any() and everywhere[~SLOW].any()
