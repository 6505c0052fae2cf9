"""Defends: work in threads gives the results of a loop, and uses no more threads than the process may."""

import threading

import pytest

from wrapjax.threads import map_in_threads, thread_count, usable_cores


@pytest.fixture(params=["1", "3"])
def threads(request, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", request.param)
    monkeypatch.setattr("wrapjax.threads.usable_cores", lambda: 4)
    return int(request.param)


def test_results_are_in_the_order_of_the_items(threads):
    assert map_in_threads(lambda item: item**2, range(20)) == [item**2 for item in range(20)]
    assert map_in_threads(str, []) == []


def test_as_many_items_as_threads_are_computed_at_once(threads):
    """The items after the first wait for each other, which one thread fewer would never end."""
    together = threading.Barrier(threads, timeout=60)
    map_in_threads(lambda item: item and together.wait(), [0, *[1] * threads])


def test_a_failure_is_raised_and_later_items_are_not_begun(threads):
    begun = []

    def fail(item):
        begun.append(item)
        raise ValueError(item)

    with pytest.raises(ValueError, match="0"):
        map_in_threads(fail, range(50))
    assert begun == [0]


@pytest.mark.parametrize("given", ["", "0", "many", "1000"])
def test_all_usable_cores_are_used_where_the_environment_says_nothing_else(monkeypatch, given):
    monkeypatch.setenv("OMP_NUM_THREADS", given)
    assert thread_count() == usable_cores() >= 1
