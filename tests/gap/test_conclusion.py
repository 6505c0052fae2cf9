"""Defends: what leads in the end has been fitted, not only scored along straight lines."""

import pytest

from wrapjax.gap.conclude import conclusion
from wrapjax.gap.fits.alternatives import Refitted
from wrapjax.gap.scene import Scene

SCENE = object.__new__(Scene)
LINEAR = {"one": 10.0, "two": 9.0, "three": 8.0, "four": 7.0, "five": -1.0}


@pytest.mark.parametrize(
    ("after", "fitted"),
    [
        ({"one": 12.0, "two": 1.0}, ["one", "two"]),
        ({"one": 2.0, "two": 1.0, "three": 7.5}, ["one", "two", "three"]),
        ({"one": 2.0, "two": 1.0, "three": 0.0, "four": 3.0}, ["one", "two", "three", "four"]),
        ({"one": -3.0, "two": -4.0, "three": -5.0, "four": -6.0}, ["one", "two", "three", "four"]),
    ],
)
def test_fits_go_on_until_the_first_was_fitted(after, fitted, monkeypatch):
    monkeypatch.setattr(conclusion, "refit", lambda scene, ids: object.__new__(Refitted))
    monkeypatch.setattr(
        conclusion, "refitted_evidence", lambda scene, refits: {id: after[id] for id in refits}
    )
    refits, refitted = conclusion._fitted_until_the_first_is(SCENE, LINEAR, ["one", "two"])
    assert list(refits) == fitted and refitted == {id: after[id] for id in fitted}


def test_where_nothing_speaks_for_any_effect_none_is_fitted():
    assert conclusion._fitted_until_the_first_is(SCENE, {"five": -1.0}, []) == ({}, {})
