"""Synergy commands agree with scikit-learn's principal components, and use one basis for all cycles."""

import numpy as np
import pytest
from sklearn.decomposition import PCA

from wrapjax.subject.synergies import fit_synergies

CHANNELS = ("a", "b", "c", "d")


@pytest.fixture(scope="module")
def emg():
    """Three cycles of four channels, two of which are nearly equal."""
    generator = np.random.default_rng(2)
    shapes = np.abs(generator.normal(size=(3, 2, 40)))
    mix = np.array([[1.0, 0.0], [0.9, 0.1], [0.0, 1.0], [0.5, 0.5]])
    return np.einsum("ck,tkf->tcf", mix, shapes) + 0.05 * np.abs(generator.normal(size=(3, 4, 40)))


def test_commands_are_scores_of_normalised_emg(emg):
    basis = fit_synergies(emg, CHANNELS, 3)
    found = basis.commands(emg, CHANNELS)
    rows = np.moveaxis(emg / emg.max(axis=(0, 2))[:, None], 1, 2).reshape(-1, 4)
    reference = PCA(3)
    scores = reference.fit_transform(rows)
    # Signs are a convention; MATLAB's makes each component's largest entry positive.
    signs = np.sign(reference.components_[range(3), np.abs(reference.components_).argmax(axis=1)])
    expected = np.moveaxis((scores * signs).reshape(3, -1, 3), 2, 1)
    np.testing.assert_allclose(found[:, :3], expected, atol=1e-13)
    np.testing.assert_array_equal(found[:, 3], 1.0)
    np.testing.assert_allclose(basis.explained, reference.explained_variance_ratio_, rtol=1e-12)
    assert (basis.components[range(3), np.abs(basis.components).argmax(axis=1)] > 0.0).all()


def test_as_many_components_as_channels_reproduce_the_emg(emg):
    basis = fit_synergies(emg, CHANNELS, 4)
    scores = basis.commands(emg, CHANNELS)[:, :4]
    back = np.einsum("kc,tkf->tcf", basis.components, scores) + basis.mean[:, None]
    np.testing.assert_allclose(back * basis.largest[:, None], emg, atol=1e-13)


def test_other_cycles_are_projected_on_the_same_components(emg):
    """The commands of a cycle do not depend on the other cycles or on the order of the channels."""
    basis = fit_synergies(emg, CHANNELS, 2)
    alone = basis.commands(3.0 * emg[:1], CHANNELS)
    np.testing.assert_array_equal(basis.commands(np.stack([3.0 * emg[0], emg[1]]), CHANNELS)[0], alone[0])
    order = np.array([2, 0, 3, 1])
    again = basis.commands(3.0 * emg[:1][:, order], tuple(CHANNELS[place] for place in order))
    np.testing.assert_allclose(again, alone, atol=1e-14)


def test_a_channel_without_signal_gives_finite_commands(emg):
    dead = emg.copy()
    dead[:, 1] = 0.0
    assert np.isfinite(fit_synergies(dead, CHANNELS, 3).commands(dead, CHANNELS)).all()


@pytest.mark.parametrize("count", [0, 5])
def test_no_more_components_than_channels(emg, count):
    with pytest.raises(ValueError, match="1 to 4 synergies"):
        fit_synergies(emg, CHANNELS, count)
