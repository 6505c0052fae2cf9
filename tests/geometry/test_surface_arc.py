"""Tests of arcs for drawing against known geodesics: circles, and an ellipsoid's principal section."""

import numpy as np
import pytest

from wrapjax.geometry.surfaces.surface_arc import geodesic_arc


def lengths(line):
    return np.linalg.norm(np.diff(line, axis=0), axis=1).sum()


def test_arcs_on_a_sphere_are_great_circles():
    turn, radius = 1.3, 0.03
    first, across = np.array([0.03, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])
    angle = np.linspace(0.0, turn, 41)[:, None]
    expected = np.cos(angle) * first + radius * np.sin(angle) * across
    # The straight line comes from outside, so that its direction has a part normal to the surface.
    found = geodesic_arc("sphere", (radius,) * 3, expected[[0, -1]], across - first, radius * turn, 40)
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_arcs_inside_the_hole_of_a_torus_are_circles():
    ring, tube, turn = 0.03, 0.008, 0.7
    angle = np.linspace(0.0, turn, 31)
    expected = (ring - tube) * np.stack([np.cos(angle), np.sin(angle), np.zeros(31)], axis=1)
    along = np.array([0.0, 2.0, 0.0])
    found = geodesic_arc("torus", (ring, tube), expected[[0, -1]], along, (ring - tube) * turn, 30)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_arcs_on_an_ellipsoid_stay_on_it():
    """Along a principal section, and across."""
    sizes = np.array([0.03, 0.05, 0.02])
    angle = np.linspace(0.2, 1.5, 4001)
    section = np.stack([sizes[0] * np.cos(angle), sizes[1] * np.sin(angle), np.zeros(4001)], axis=1)
    length = float(lengths(section))
    found = geodesic_arc("ellipsoid", sizes.tolist(), section[[0, -1]], section[1] - section[0], length, 80)
    np.testing.assert_allclose(np.sum((found / sizes) ** 2, axis=1), 1.0, atol=1e-5)
    assert np.abs(found[:, 2]).max() < 1e-12
    assert lengths(found) == pytest.approx(length, rel=1e-4)


def test_a_contact_without_length_is_its_two_points():
    ends = np.array([[0.03, 0.0, 0.0], [0.03, 0.0, 0.0]])
    found = geodesic_arc("sphere", (0.03,) * 3, ends, np.zeros(3), 0.0, 1)
    np.testing.assert_array_equal(found, ends)
