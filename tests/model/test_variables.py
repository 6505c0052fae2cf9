"""Batches of muscles with similar numbers of local entries."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from wrapjax.model.variables import MAX_BATCHES, Batch, divide_muscles, of_batch


def free_entries(counts):
    """Mark the first entries of each muscle as free."""
    return np.arange(12) < np.array(counts)[:, None]


@given(st.lists(st.integers(1, 12), min_size=1, max_size=9))
def test_every_muscle_is_in_one_batch_that_has_room_for_its_entries(counts):
    batches = divide_muscles(free_entries(counts))
    assert sorted(itertools.chain(*(batch.muscles for batch in batches))) == list(range(len(counts)))
    assert len(batches) <= MAX_BATCHES
    for batch in batches:
        assert max(counts[muscle] for muscle in batch.muscles) == batch.entries


@given(st.lists(st.integers(1, 12), min_size=6, max_size=9, unique=True))
def test_no_other_division_in_order_needs_less_padding(counts):
    needed = sum(len(batch.muscles) * batch.entries for batch in divide_muscles(free_entries(counts)))
    ordered = sorted(counts)
    for cuts in itertools.combinations(range(1, len(ordered)), MAX_BATCHES - 1):
        parts = [ordered[first:last] for first, last in itertools.pairwise((0, *cuts, len(ordered)))]
        assert needed <= sum(len(part) * part[-1] for part in parts)


def test_a_held_entry_between_free_ones_keeps_its_place():
    assert divide_muscles(np.array([[True, False, True, False]])) == (Batch((0,), 3),)


def test_of_batch_selects_the_rows_of_its_muscles():
    rows = np.arange(4)
    np.testing.assert_array_equal(of_batch(Batch((3, 1), 2), rows), [3, 1])
    np.testing.assert_array_equal(of_batch(Batch((0, 1), 2), (rows,))[0], [0, 1])
