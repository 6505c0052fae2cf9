"""Tests of muscle analysis with placed cylinders: results, cached files, worker processes."""

import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.osim import muscle_analysis
from wrapjax.osim.muscle_analysis import analyse_placements
from wrapjax.osim.path_engine import PathEngine

MUSCLES, COORDINATES = ("flexor", "extensor"), ("hip", "knee")


@pytest.fixture(scope="module")
def inputs(odd_model):
    """Ten placements, the first of them nominal, which is more than one file holds."""
    generator = np.random.default_rng(8)
    poses = generator.uniform(0.0, 1.5, (5, 2))
    low, high = np.array([-0.01, -0.01, -0.01, -0.3, -0.3, 0.8]), np.array([0.01, 0.01, 0.01, 0.3, 0.3, 1.2])
    moved = [{"condyles": low + (high - low) * generator.random(6)} for _ in range(9)]
    return odd_model, MUSCLES, COORDINATES, poses, [{}, *moved]


def test_results_equal_opensims(inputs):
    file, _, _, poses, placements = inputs
    found = analyse_placements(*inputs, processes=1, quiet=True)
    reference = PathEngine(file, COORDINATES, found.spans)
    for row, wraps in enumerate(placements):
        reference.place(wraps)
        length, moment_arm = reference.analyse(poses)
        for column, muscle in enumerate(MUSCLES):
            own_length, own_arm = found.of(muscle)
            # Results are stored in single precision.
            np.testing.assert_allclose(own_length[row], length[:, column], atol=5e-8)
            np.testing.assert_allclose(own_arm[row], moment_arm[:, :, column], atol=5e-8)
    moved = np.abs(np.diff(found.of("flexor")[0], axis=0)).max()
    assert moved > 1e-3 and np.abs(np.diff(found.of("extensor")[0], axis=0)).max() == 0.0


def test_only_missing_results_are_computed_again(inputs, monkeypatch):
    first = analyse_placements(*inputs, processes=1, quiet=True)
    length = first.of("flexor")[0]
    first.files[1].unlink()
    analysed = []
    analyse = muscle_analysis.analyse_chunks

    def recording(file, coordinates, spans, chunks, processes):
        analysed.extend(chunks)
        return analyse(file, coordinates, spans, chunks, processes)

    monkeypatch.setattr(muscle_analysis, "analyse_chunks", recording)
    again = analyse_placements(*inputs, processes=1, quiet=True)
    assert analysed == [muscle_analysis.PLACED_CHUNK]
    np.testing.assert_array_equal(again.of("flexor")[0], length)
    analyse_placements(*inputs, processes=1, quiet=True)
    assert analysed == [muscle_analysis.PLACED_CHUNK]


def test_workers_give_identical_results(inputs, monkeypatch, tmp_path):
    monkeypatch.setenv("WRAPJAX_CACHE", str(tmp_path / "one"))
    alone = analyse_placements(*inputs, processes=1, quiet=True)
    monkeypatch.setenv("WRAPJAX_CACHE", str(tmp_path / "two"))
    shared = analyse_placements(*inputs, processes=2, quiet=True)
    assert not {*alone.files} & {*shared.files}
    for one, other in zip(alone.of("flexor"), shared.of("flexor"), strict=True):
        np.testing.assert_array_equal(one, other)


def test_an_unknown_muscle_is_an_error(inputs):
    with pytest.raises(InputError, match="flexer"):
        analyse_placements(inputs[0], ["flexer"], *inputs[2:], quiet=True)
