"""Tests that each criterion for physiological paths detects its fault and no other."""

from dataclasses import fields

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.geometry.exact_paths.engine import surfaces_of
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS, Margins, WrappedPath
from wrapjax.geometry.skeleton.model_description import WrapObject
from wrapjax.geometry.surfaces.wrap_methods import kind_of
from wrapjax.geometry.surrogates.physiological import (
    PhysiologicalThresholds,
    distance_from_bones,
    measure_paths,
)

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


#: Thresholds of paths; that of a wrap's distance from bones is tested with fits.
OF_PATHS = sorted({field.name for field in fields(PhysiologicalThresholds)} - {"bone_distance"})


@pytest.mark.parametrize("name", OF_PATHS)
def test_each_threshold_can_be_set(name):
    measures = measure_paths(paths(3, changed_slightly), paths(1), CYCLE)
    assert measures.physiological().all()
    strict = PhysiologicalThresholds(**{name: 1.0 if name == "variability" else 0.0})
    np.testing.assert_array_equal(measures.physiological(strict), [True, False, True])


# ---- Distance from bones

TURNED, PLACE = (0.4, -0.2, 0.7), (0.01, -0.3, 0.02)
WRAPS = {
    kind: WrapObject("wrap", kind, "femur_l", PLACE, TURNED, *sizes[:2], "all", True, sizes[2])
    for kind, sizes in {
        "WrapCylinder": (0.03, 0.1, ()),
        "WrapSphere": (0.03, None, ()),
        "WrapEllipsoid": (None, None, (0.02, 0.03, 0.05)),
        "WrapTorus": (None, None, (0.04, 0.01)),
    }.items()
}


def surface_of(kind):
    return jax.tree.map(lambda leaf: leaf[0], surfaces_of([WRAPS[kind]]))


def points_of(kind):
    """Points on the nominal surface at a spacing of about 0.5 mm, in the body's frame."""
    turn, along = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 400), np.linspace(0.0, 1.0, 400))
    if kind == "WrapCylinder":
        # The side, and both ends, to which the distance is that of a solid.
        side = (0.03 * np.cos(turn), 0.03 * np.sin(turn), 0.1 * (along - 0.5))
        ends = [
            (0.03 * along * np.cos(turn), 0.03 * along * np.sin(turn), 0 * turn + z) for z in (0.05, -0.05)
        ]
        own = np.concatenate([np.stack(part, axis=-1).reshape(-1, 3) for part in (side, *ends)])
    elif kind == "WrapTorus":
        tube = 2.0 * np.pi * along
        ring = 0.04 + 0.01 * np.cos(tube)
        own = np.stack([ring * np.cos(turn), ring * np.sin(turn), 0.01 * np.sin(tube)], axis=-1).reshape(
            -1, 3
        )
    else:
        sizes = np.array(WRAPS[kind].sizes or (0.03,) * 3)
        up = np.pi * along
        unit = np.stack([np.sin(up) * np.cos(turn), np.sin(up) * np.sin(turn), np.cos(up)], axis=-1)
        own = (unit * sizes).reshape(-1, 3)
    return np.asarray(surface_of(kind).center) + own @ np.asarray(surface_of(kind).rotation).T


def distances(kind, bone, *parameters):
    values = np.array([NOMINAL_PARAMETERS, *parameters])
    name = kind_of(WRAPS[kind].kind, "hybrid")
    return distance_from_bones(surface_of(kind), name, np.atleast_2d(bone), values)


@pytest.mark.parametrize("kind", ["WrapCylinder", "WrapSphere", "WrapTorus"])
def test_the_distance_is_that_of_the_nearest_point(kind):
    """Against all points of the surface, for bones outside of it; zero for one inside."""
    surface = points_of(kind)
    bones = np.array(PLACE) + np.random.default_rng(0).uniform(-0.12, 0.12, (40, 3))
    outside = 0
    for bone in bones:
        (found,) = distances(kind, bone)
        if found > 0.0:
            outside += 1
            assert found == pytest.approx(np.linalg.norm(surface - bone, axis=1).min(), abs=1e-4)
    assert outside > 25
    middle = surfaces_of([WRAPS[kind]])
    inside = (
        np.asarray(middle.center)[0]
        + (0.04 if kind == "WrapTorus" else 0.01) * np.asarray(middle.rotation)[0, :, 0]
    )
    assert distances(kind, np.stack([inside, bones[0]])) == 0.0


def test_an_ellipsoids_distance_is_never_smaller_than_the_true_one():
    """It is measured towards the center, so that it is exact on the axes."""
    surface, frame = points_of("WrapEllipsoid"), surface_of("WrapEllipsoid")
    for bone in np.array(PLACE) + np.random.default_rng(1).uniform(-0.12, 0.12, (20, 3)):
        (found,) = distances("WrapEllipsoid", bone)
        assert found == 0.0 or found > np.linalg.norm(surface - bone, axis=1).min() - 1e-4
    for axis, size in enumerate((0.02, 0.03, 0.05)):
        bone = np.asarray(frame.center) + (size + 0.007) * np.asarray(frame.rotation)[:, axis]
        assert distances("WrapEllipsoid", bone) == pytest.approx(0.007, abs=1e-12)


@pytest.mark.parametrize("kind", list(WRAPS))
def test_the_distance_follows_the_wrap(kind):
    """A wrap that is translated along its own x-axis away from a bone on it, or shrunk."""
    frame = surface_of(kind)
    farthest = {"WrapTorus": 0.05, "WrapEllipsoid": 0.02}.get(kind, 0.03)
    bone = np.asarray(frame.center) + (farthest + 0.002) * np.asarray(frame.rotation)[:, 0]
    away, smaller = NOMINAL_PARAMETERS.copy(), NOMINAL_PARAMETERS.copy()
    away[0] -= 0.005
    smaller[5] = 0.9
    found = distances(kind, bone, away, smaller)
    np.testing.assert_allclose(found, [0.002, 0.007, 0.002 + 0.1 * farthest], atol=1e-12)
