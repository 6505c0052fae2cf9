"""Division of the contact force of a knee between its medial and lateral compartment."""

import numpy as np
import pytest

from wrapjax.contact_forces.contact_result import knee_compartments


def on_tibia(points, forces):
    """Moment about the center and force of forces (N) that act at points (m)."""
    return np.concatenate([np.cross(points, forces).sum(axis=0), np.sum(forces, axis=0)])[:, None]


@pytest.mark.parametrize(("side", "medial"), [("r", -0.02), ("l", 0.02)])
def test_forces_at_two_points_are_recovered(side, medial):
    """Medial is to the left of a right knee. Shear and moments about other axes have no influence."""
    points = [[0.01, 0.0, medial], [-0.02, 0.0, -medial]]
    forces = [[50.0, -700.0, 30.0], [-20.0, -300.0, 10.0]]
    np.testing.assert_allclose(
        knee_compartments(on_tibia(points, forces), 0.04, side)[:, 0], [700.0, 300.0], rtol=1e-12
    )


def test_a_force_beyond_a_condyle_opens_the_other_side():
    found = knee_compartments(on_tibia([[0.0, 0.0, -0.03]], [[0.0, -1000.0, 0.0]]), 0.04, "r")[:, 0]
    np.testing.assert_allclose(found, [1250.0, -250.0], rtol=1e-12)
