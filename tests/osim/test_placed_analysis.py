"""Defends: placed cylinders give OpenSim's own paths, and interrupted work goes on where it stopped."""

import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.osim import placed_analysis
from wrapjax.osim.path_engine import PathEngine
from wrapjax.osim.placed_analysis import analyse_placements

MUSCLES, COORDINATES = ("flexor", "extensor"), ("hip", "knee")


@pytest.fixture(scope="module")
def question(odd_model):
    """Ten placements, the first nominal: more than are kept in one file."""
    generator = np.random.default_rng(8)
    poses = generator.uniform(0.0, 1.5, (5, 2))
    low, high = np.array([-0.01, -0.01, -0.01, -0.3, -0.3, 0.8]), np.array([0.01, 0.01, 0.01, 0.3, 0.3, 1.2])
    moved = [{"condyles": low + (high - low) * generator.random(6)} for _ in range(9)]
    return odd_model, MUSCLES, COORDINATES, poses, [{}, *moved]


def test_results_are_opensims_own(question):
    file, _, _, poses, placements = question
    found = analyse_placements(*question, processes=1, quiet=True)
    judge = PathEngine(file, COORDINATES, found.spans)
    for row, wraps in enumerate(placements):
        judge.place(wraps)
        length, moment_arm = judge.analyse(poses)
        for column, muscle in enumerate(MUSCLES):
            own_length, own_arm = found.of(muscle)
            # Single precision is kept.
            np.testing.assert_allclose(own_length[row], length[:, column], atol=5e-8)
            np.testing.assert_allclose(own_arm[row], moment_arm[:, :, column], atol=5e-8)
    moved = np.abs(np.diff(found.of("flexor")[0], axis=0)).max()
    assert moved > 1e-3 and np.abs(np.diff(found.of("extensor")[0], axis=0)).max() == 0.0


def test_only_what_is_missing_is_analysed_again(question, monkeypatch):
    first = analyse_placements(*question, processes=1, quiet=True)
    kept = first.of("flexor")[0]
    first.files[1].unlink()
    asked = []
    analyse = placed_analysis.analyse_chunks

    def watched(file, coordinates, spans, chunks, processes):
        asked.extend(chunks)
        return analyse(file, coordinates, spans, chunks, processes)

    monkeypatch.setattr(placed_analysis, "analyse_chunks", watched)
    again = analyse_placements(*question, processes=1, quiet=True)
    assert asked == [placed_analysis.CHUNK]
    np.testing.assert_array_equal(again.of("flexor")[0], kept)
    analyse_placements(*question, processes=1, quiet=True)
    assert asked == [placed_analysis.CHUNK]


def test_workers_give_the_same(question, monkeypatch):
    monkeypatch.setattr(placed_analysis, "_FORMAT", "for this test")
    alone = analyse_placements(*question, processes=1, quiet=True).of("flexor")
    monkeypatch.setattr(placed_analysis, "_FORMAT", "for this test, too")
    shared = analyse_placements(*question, processes=2, quiet=True).of("flexor")
    for one, other in zip(alone, shared, strict=True):
        np.testing.assert_array_equal(one, other)


def test_unknown_muscle(question):
    with pytest.raises(InputError, match="flexer"):
        analyse_placements(question[0], ["flexer"], *question[2:], quiet=True)
