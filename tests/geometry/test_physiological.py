"""Tests that each criterion for physiological paths detects its fault and no other."""

from dataclasses import fields

import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.geometry.physiological import PhysiologicalThresholds, measure_paths
from wrapjax.geometry.wrapping import Margins, WrappedPath

POSES, CYCLE = 60, slice(20, None)
WAVE = np.sin(2.0 * np.pi * np.arange(POSES) / 40.0)


def paths(samples, change=None):
    """Copies of a nominal path that touches the first of two cylinders, with a point inside it in pose 3.

    The second copy is changed by a function.
    """
    parts = {
        "length": np.tile(0.3 + 0.02 * WAVE, (samples, 1)),
        "moment_arm": np.tile((0.04 + 0.004 * WAVE)[:, None], (samples, 1, 2)),
        "on_surface": np.tile([0.02, 0.0], (samples, POSES, 1)),
        "inside": np.full((samples, POSES), 0.01),
        "off_end": np.full((samples, POSES), 0.02),
        "long_wrap": np.full((samples, POSES), 1.0),
    }
    parts["inside"][:, 3] = -0.001
    if change is not None:
        change(**{name: part[1] for name, part in parts.items()})
    parts = {name: jnp.asarray(part) for name, part in parts.items()}
    margins = Margins(*(parts.pop(name) for name in ("inside", "off_end", "long_wrap")))
    return WrappedPath(margins=margins, clearances=jnp.zeros((samples, POSES, 0)), **parts)


def longer_everywhere(length, **_):
    length += 0.03


def another_moment_arm(moment_arm, **_):
    moment_arm[:, 1] -= 0.0195
    moment_arm[5, 1] -= 0.001


def varies_much_more(moment_arm, **_):
    # The change is smooth, and smaller than the threshold of deviations.
    moment_arm[:, 0] += 0.015 * WAVE


def steps_along_the_cycle(length, **_):
    length[40:] += 0.0015


def steps_from_the_last_frame_to_the_first(length, **_):
    length[CYCLE] += np.linspace(0.0, 0.0015, 40)


def kinks(moment_arm, **_):
    moment_arm[30:50, 1] += 0.004


def has_a_point_inside(inside, **_):
    inside[7] = -1e-6


def is_off_the_end(off_end, **_):
    off_end[7] = -1e-6


def wraps_the_long_way(long_wrap, **_):
    long_wrap[7] = -1e-6


def never_touches(on_surface, **_):
    on_surface[:, 0] = 0.0


FAULTS = {
    longer_everywhere: {"length_deviation"},
    another_moment_arm: {"moment_arm_deviation"},
    varies_much_more: {"variability"},
    steps_along_the_cycle: {"length_step"},
    steps_from_the_last_frame_to_the_first: {"length_step"},
    kinks: {"moment_arm_step"},
    has_a_point_inside: {"jumps"},
    is_off_the_end: {"jumps"},
    wraps_the_long_way: {"jumps"},
    never_touches: {"never_touches"},
}


@pytest.mark.parametrize("change", FAULTS, ids=lambda change: change.__name__)
def test_each_criterion_detects_its_fault(change):
    """One of three samples has the fault. A pose in which the nominal path is inside too is no fault."""
    measures = measure_paths(paths(3, change), paths(1), CYCLE)
    failed = {name for name, samples in measures.failed_criteria().items() if samples[1]}
    assert failed == FAULTS[change]
    np.testing.assert_array_equal(measures.physiological(), [True, False, True])


def test_unordered_poses_have_no_steps():
    found = paths(3, steps_along_the_cycle)
    assert measure_paths(found, paths(1), slice(0, 0)).physiological().all()


def changed_slightly(length, moment_arm, on_surface, **_):
    length *= 1.001
    moment_arm *= 1.001
    on_surface[4, 1] = 0.001


def test_new_contacts_are_counted_by_pose():
    """The second wrap, which the nominal path never touches, is touched in one of 60 poses."""
    measures = measure_paths(paths(3, changed_slightly), paths(1), CYCLE)
    np.testing.assert_allclose(measures.new_contact, [0.0, 1.0 / POSES, 0.0])


@pytest.mark.parametrize("name", [field.name for field in fields(PhysiologicalThresholds)])
def test_each_threshold_can_be_set(name):
    measures = measure_paths(paths(3, changed_slightly), paths(1), CYCLE)
    assert measures.physiological().all()
    strict = PhysiologicalThresholds(**{name: 1.0 if name == "variability" else 0.0})
    np.testing.assert_array_equal(measures.physiological(strict), [True, False, True])
