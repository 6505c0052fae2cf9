"""Shortest paths through tori: several ways, narrow holes, and ends inside the tube."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from validation.wrapping.shortest_paths import CHORDS, engine_paths, through_torus, torus_oracle
from validation.wrapping.single_path import SurfaceDraw
from wrapjax.geometry.exact_paths.engine import surfaces_of
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS
from wrapjax.geometry.skeleton.model_description import WrapObject
from wrapjax.geometry.surfaces import torus
from wrapjax.geometry.vectors import vector


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sizes", "start", "end"),
    [
        ((0.0165, 0.0071), (-0.0042, 0.0163, 0.0085), (-0.0243, -0.0073, -0.0162)),
        ((0.0218, 0.0068), (0.0015, -0.0269, 0.0069), (0.0582, 0.0093, -0.0505)),
    ],
)
def test_of_several_ways_through_a_torus_the_shortest_is_found(sizes, start, end):
    """Two ways are shorter than all their neighbors, and differ by a quarter of a millimeter."""
    polylines = [through_torus(chords) for chords in CHORDS]
    ends = np.array([*start, *end])
    length, _, on_surface = engine_paths(SurfaceDraw("torus", sizes), ends[None])
    expected = torus_oracle(ends[:3], ends[3:], np.array([*sizes, sizes[1]]), polylines)
    assert on_surface[0] > 0.01
    assert length[0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("sizes", "start", "end"),
    [
        ((0.045113, 0.013557), (0.021705, -0.054605, 0.081456), (0.011597, -0.01327, -0.04094)),
        ((0.047214, 0.011807), (-0.010343, 0.000147, 0.063848), (-0.066961, 0.023287, -0.093835)),
        ((0.043881, 0.013719), (0.043893, 0.022519, 0.085117), (0.020972, 0.000579, -0.043986)),
    ],
)
def test_a_path_that_hardly_touches_a_torus_is_found(sizes, start, end):
    """Straight lines through the tube at a depth of a tenth of a millimeter."""
    polylines = [through_torus(chords) for chords in CHORDS]
    ends = np.array([*start, *end])
    length, _, on_surface = engine_paths(SurfaceDraw("torus", sizes), ends[None])
    expected = torus_oracle(ends[:3], ends[3:], np.array([*sizes, sizes[1]]), polylines)
    assert 0.0 < on_surface[0] < 1e-3
    assert length[0] == pytest.approx(expected, abs=1e-6)


def narrow_torus():
    """Torus of the wrist's extensors in a public model; its hole is half as wide as its tube."""
    return SurfaceDraw("torus", (0.009, 0.006))


def test_straight_lines_continue_the_path_through_a_narrow_torus():
    """Its slopes by the ends are the lines' directions; lines that pass through the tube reflect the path."""
    ends = np.array([0.0056, 0.0071, 0.0118, 0.0099, -0.0241, -0.0172])
    moved = ends + 1e-6 * np.concatenate([np.zeros((1, 6)), np.eye(6), -np.eye(6)])
    length, slope, on_surface = engine_paths(narrow_torus(), moved)
    assert on_surface[0] > 0.005
    # The polynomial's own error; of a reflected path it is 0.08.
    np.testing.assert_allclose(slope[0], (length[1:7] - length[7:]) / 2e-6, atol=2e-5)


def shortest_in_space(start, end, sizes, by):
    """Length of a polyline in space whose points stay out of the tube, by sequential quadratic programming.

    It begins as two straight lines by a given point. In millimeters the optimum is found on any processor.
    """
    start, end, sizes, by = (1e3 * np.asarray(given) for given in (start, end, sizes, by))

    def all_points(inner):
        return jnp.concatenate([start[None], inner.reshape(-1, 3), end[None]])

    @jax.jit
    def depth(inner):
        """Distance from the tube of points between the corners, too, mm."""
        points = all_points(inner)
        points = jnp.concatenate([points[1:-1], 0.5 * (points[1:] + points[:-1])])
        return jnp.hypot(jnp.hypot(points[:, 0], points[:, 1]) - sizes[0], points[:, 2]) - sizes[1]

    @jax.jit
    def length_of(inner):
        """With equal chords the polyline's length, mm, and more with unequal ones."""
        chords = jnp.diff(all_points(inner), axis=0)
        return jnp.sqrt(len(chords) * jnp.sum(chords**2))

    share = np.linspace(0.0, 1.0, 22)[1:-1, None]
    first = np.where(share < 0.4, start + (by - start) * share / 0.4, by + (end - by) * (share - 0.4) / 0.6)
    found = scipy.optimize.minimize(
        length_of,
        first.ravel(),
        jac=jax.jit(jax.grad(length_of)),
        constraints={"type": "ineq", "fun": depth, "jac": jax.jit(jax.jacfwd(depth))},
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-7},
    )
    assert found.success, found.message
    assert depth(found.x).min() > -1e-6
    return 1e-3 * found.fun


def test_a_path_through_a_narrow_torus_is_the_shortest_outside_of_the_tube():
    """Against a polyline that begins by the hole's center, so that it is on no side of it."""
    start, end = np.array([0.0056, 0.0071, 0.0118]), np.array([0.0099, -0.0241, -0.0172])
    (length,), _, _ = engine_paths(narrow_torus(), np.concatenate([start, end])[None])
    assert length == pytest.approx(shortest_in_space(start, end, (0.009, 0.006), np.zeros(3)), abs=1e-4)


@pytest.mark.parametrize(
    "end", [(0.1, 0.01, 0.02), (0.02, 0.1, 0.02), (-0.05, 0.05, 0.02), (0.0, 0.0, -0.05), (0.1, 0.01, -0.02)]
)
@pytest.mark.parametrize("reverse", [False, True])
def test_from_an_end_inside_a_torus_the_path_begins_along_the_surface(end, reverse):
    """The slopes by the ends are those of length; a polyline of few chords is a bit longer."""
    sizes, start, step = (0.03, 0.01), np.array([0.035, 0.002, 0.003]), 1e-6
    both = np.concatenate([end, start] if reverse else [start, end])
    ends = both + step * np.concatenate([np.zeros((1, 6)), np.eye(6), -np.eye(6)])
    length, slope, on_surface = engine_paths(SurfaceDraw("torus", sizes), ends)
    np.testing.assert_allclose(slope[0], (length[1:7] - length[7:]) / (2.0 * step), atol=1e-7)
    if not on_surface.any():
        assert length[0] == pytest.approx(np.linalg.norm(end - start), abs=1e-15)
        return
    middle = np.array([*start[:2], 0.0]) * (sizes[0] / np.linalg.norm(start[:2]))
    moved = middle + (start - middle) * (sizes[1] / np.linalg.norm(start - middle))
    # Over the tube, or through the hole.
    by = np.array([0.0, 0.0, 0.04 if end[2] > 0.0 else 0.0])
    polyline = shortest_in_space(moved, np.array(end), sizes, by)
    assert polyline - 1.1e-3 < length[0] < polyline + 1e-6


def wide_tube_contacts(ends):
    """Contacts with a torus whose hole is less than half as wide as its tube."""
    wrap = WrapObject(
        "cuff", "WrapTorus", "thigh", (0.0,) * 3, (0.0,) * 3, None, None, "all", True, (0.02, 0.014)
    )
    surface = jax.tree.map(lambda leaf: leaf[0], surfaces_of([wrap])).placed(jnp.asarray(NOMINAL_PARAMETERS))
    start, end = (vector(jnp.asarray(part)) for part in (ends[:, :3], ends[:, 3:]))
    return torus.geodesic_contact(start, end, surface, torus.decide_wrapping(start, end, surface))


def swept(ends, count):
    """Ends of segments of which the start moves by 2 mm to either side."""
    moves = np.linspace(-2e-3, 2e-3, count)
    return np.array(ends) + np.outer(moves, [1.0, -1.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.slow
def test_the_margin_through_a_torus_is_zero_where_the_path_takes_another_way():
    """The margin is the other way's extra length: PGA keeps from where moment arms jump."""
    contact = wide_tube_contacts(swept((-0.0592, 0.0327, 0.038, 0.0523, -0.0293, -0.0427), 81))
    margin = 0.014 * (np.pi - np.asarray(contact.turn))
    change = np.abs(np.diff(np.asarray(contact.start_pull.x)))
    (switch,) = np.flatnonzero(change > 0.02)
    assert change[switch] > 0.05
    assert (margin > 0.0).all() and margin[switch : switch + 2].max() < 1e-5
    slopes = np.diff(margin)
    assert (slopes[:switch] < 0.0).all() and (slopes[switch + 1 :] > 0.0).all()


def test_the_shorter_of_two_ways_through_a_narrow_hole_is_found_in_all_poses():
    """The length has no jump where the start moves."""
    contact = wide_tube_contacts(swept((0.0458, 0.0013, 0.0519, -0.0255, -0.0064, -0.0207), 81))
    second = np.diff(np.asarray(contact.total), 2)
    assert np.abs(second).max() < 2e-5
