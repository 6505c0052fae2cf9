"""Tests that drawn meshes of surfaces other than cylinders lie on the surfaces."""

import numpy as np
import pytest

from wrapjax.report.model_view.wrap_shapes import local_mesh


@pytest.mark.parametrize("kind, sizes", [("sphere", (0.03,) * 3), ("ellipsoid", (0.03, 0.05, 0.02))])
def test_vertices_of_ellipsoids_are_on_them(kind, sizes):
    vertices, triangles, lines = local_mesh(kind, sizes)
    np.testing.assert_allclose(np.sum((vertices / np.array(sizes)) ** 2, axis=1), 1.0, atol=1e-12)
    assert triangles.max() == lines.max() == len(vertices) - 1
    assert volume(vertices, triangles) == pytest.approx(4.0 / 3.0 * np.pi * np.prod(sizes), rel=0.03)


def test_vertices_of_tori_are_on_them():
    ring, tube = 0.03, 0.008
    vertices, triangles, _ = local_mesh("torus", (ring, tube, tube))
    aside = np.hypot(vertices[:, 0], vertices[:, 1]) - ring
    np.testing.assert_allclose(np.hypot(aside, vertices[:, 2]), tube, atol=1e-12)
    assert volume(vertices, triangles) == pytest.approx(2.0 * np.pi**2 * ring * tube**2, rel=0.05)


def volume(vertices, triangles):
    """Volume that triangles enclose, whichever way round all of them are listed."""
    one, two, three = np.moveaxis(vertices[triangles], 1, 0)
    return abs(np.sum(one * np.cross(two, three))) / 6.0
