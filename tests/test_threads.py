"""Defends: work in threads gives the results of a loop, and uses no more threads than the process may."""

import threading

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from wrapjax.threads import call_together, map_in_threads, thread_count, usable_cores


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


def test_two_functions_are_called_at_once_and_give_their_results(threads):
    """With two threads or more each waits for the other, which one alone would never end."""
    together = threading.Barrier(min(threads, 2), timeout=60)
    assert call_together(lambda: (together.wait(), "one")[1], lambda: (together.wait(), 2)[1]) == ("one", 2)


@pytest.mark.parametrize(("first", "second", "raised"), [(1, 0, "first"), (0, 1, "second"), (1, 1, "first")])
def test_a_failure_of_either_function_is_raised(threads, first, second, raised):
    def call(fails, name):
        if fails:
            raise ValueError(name)

    with pytest.raises(ValueError, match=raised):
        call_together(lambda: call(first, "first"), lambda: call(second, "second"))


def test_linear_algebra_has_one_thread_beside_threads(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.setattr("wrapjax.threads.usable_cores", lambda: 2)

    def blas_threads(_=None):
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        assert map_in_threads(blas_threads, range(3))[1:] == [{1}, {1}]
        assert call_together(blas_threads, blas_threads) == ({1}, {1})
        assert blas_threads() == before


@pytest.mark.parametrize("given", ["", "0", "many", "1000"])
def test_all_usable_cores_are_used_where_the_environment_says_nothing_else(monkeypatch, given):
    monkeypatch.setenv("OMP_NUM_THREADS", given)
    assert thread_count() == usable_cores() >= 1
