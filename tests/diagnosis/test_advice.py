"""The advised experiment is the shortest one that tells tied effects apart."""

import pytest

from wrapjax.diagnosis.claims.advice import advise, effects_by_experiment
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.experiments import EMG_AT_REST, EXPERIMENTS


def test_every_experiment_shows_an_effect():
    menu = effects_by_experiment()
    shown = [id for ids in menu.values() for id in ids]
    assert sorted(shown) == sorted(id for id, one in CATALOGUE.items() if one.experiment is not None)
    assert all(menu.values()) and tuple(menu) == EXPERIMENTS
    assert all(experiment.minutes > 0 and experiment.text for experiment in menu)


def test_an_experiment_that_shows_all_tied_effects_is_not_advised():
    """It shows that one of them is present, but not which."""
    together = ("contracture", "passive_joint_moment")
    assert advise(together, 1.0, 8) is None
    found = advise((*together, "joint_damping"), 1.0, 8)
    assert found is not None
    assert "slowly" in found.experiment
    assert found.splits == (*together, "joint_damping")


def test_the_shortest_experiment_that_separates_effects_is_advised():
    found = advise(("missing_drive", "joint_damping", "emg_offset"), 1.0, 8)
    assert (found.minutes, found.experiment) == (1, EMG_AT_REST.text)
    longer = advise(("missing_drive", "joint_damping"), 1.0, 8)
    assert longer.minutes == 6
    assert advise(("no", "such"), 1.0, 8) is None


@pytest.mark.parametrize(("apart", "cycles"), [(2.0, 24), (6.0, 8), (5.0, 10), (0.0, None)])
def test_number_of_cycles_that_make_one_effect_twenty_times_as_likely(apart, cycles):
    """Squared distances add up over cycles; half of six is the logarithm of 20."""
    assert advise(("missing_drive", "joint_damping"), apart, 8).cycles == cycles
