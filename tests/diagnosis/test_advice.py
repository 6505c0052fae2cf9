"""What to record next: things that exist, and that tell apart what could not be told apart."""

import pytest

from wrapjax.diagnosis.advice import MENU, advise
from wrapjax.diagnosis.effects.catalogue import CATALOGUE


def test_the_menu_speaks_of_effects_of_the_catalogue():
    shown = [id for experiment in MENU for id in experiment.shows]
    assert set(shown) <= set(CATALOGUE)
    assert len(set(shown)) == len(shown), "one experiment an effect"
    assert all(experiment.minutes > 0 and experiment.text for experiment in MENU)


def test_what_shows_all_members_of_a_tie_is_not_advised():
    """Both would show on it: it says that one is there, and not which."""
    together = ("contracture", "passive_joint_moment")
    assert advise(together, 1.0, 8) is None
    found = advise((*together, "joint_damping"), 1.0, 8)
    assert found is not None
    assert "slowly" in found.experiment
    assert found.splits == (*together, "joint_damping")


def test_the_cheapest_that_splits_is_advised():
    found = advise(("missing_drive", "joint_damping", "emg_offset"), 1.0, 8)
    assert (found.minutes, found.experiment) == (1, MENU[0].text)
    dear = advise(("missing_drive", "joint_damping"), 1.0, 8)
    assert dear.minutes == 6
    assert advise(("no", "such"), 1.0, 8) is None


@pytest.mark.parametrize(("apart", "cycles"), [(2.0, 24), (6.0, 8), (5.0, 10), (0.0, None)])
def test_so_many_cycles_would_make_one_twenty_times_as_likely(apart, cycles):
    """Differences add up over cycles, and half of six is the logarithm of 20."""
    assert advise(("missing_drive", "joint_damping"), apart, 8).cycles == cycles
