"""Defends: surfaces of bones are read and placed, and damaged files are refused by name."""

import numpy as np
import pytest

from tests.osim.bone_file import TETRAHEDRON
from wrapjax.errors import InputError
from wrapjax.geometry.skeleton.model_description import Pose
from wrapjax.osim.bones import AttachedMesh, find_bones, read_vtp


def test_bones_are_read_and_placed(tmp_path):
    file = tmp_path / "thigh.vtp"
    file.write_text(TETRAHEDRON)
    vertices, triangles = read_vtp(file)
    assert vertices.shape == (5, 3)
    assert sorted(map(sorted, triangles.tolist())) == [[0, 1, 2], [0, 1, 4], [0, 2, 3], [1, 2, 4]]
    quarter = Pose(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.5))
    thigh = AttachedMesh("thigh.vtp", "femur_l", quarter, (2.0, 1.0, 1.0))
    lost = AttachedMesh("shank.vtp", "tibia_l", quarter, (1.0, 1.0, 1.0))
    (bone,), missing = find_bones((thigh, lost), (tmp_path / "none", tmp_path))
    np.testing.assert_allclose(bone.vertices[[1, 3, 4]], [[0, 2, 0.5], [-1, 0, 0.5], [0, 0, 1.5]], atol=1e-12)
    assert bone.body == "femur_l" and missing == ("shank.vtp",)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<VTKFile", "<VTK", "not well-formed"),
        ('format="ascii">\n', 'format="appended">\n', "found 'appended'"),
        ("0 1 2 3 0 1 4 1 2 4", "0 1 2 3 0 1 4 1 2 9", "vertices that it does not hold"),
        ("4 7 10", "4 3 10", "ascending ends"),
        ("4 7 10", "4 7 9", "up to the last"),
        ("4 7 10", "4 7 1e300", "whole numbers"),
        ("0 1 2 3 0 1 4 1 2 4", "0 1 2 3 0 1 4 1 2.5 4", "whole numbers"),
        ("0 0 1</DataArray></Points>", "0 0 x</DataArray></Points>", "expected numbers"),
        ("0 0 1</DataArray></Points>", "0 0</DataArray></Points>", "three for each vertex"),
        ("0 0 1</DataArray></Points>", "0 0 nan</DataArray></Points>", "finite numbers"),
        ('Name="offsets"', 'Name="ends"', "DataArray of offsets, found none"),
        ("<Piece", "<!-- <Piece", "not well-formed"),
        ('<Piece NumberOfPoints="5" NumberOfPolys="3">', "<Other>", "not well-formed"),
    ],
)
def test_damaged_bones_are_refused(tmp_path, old, new, message):
    file = tmp_path / "thigh.vtp"
    assert old in TETRAHEDRON
    file.write_text(TETRAHEDRON.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as caught:
        read_vtp(file)
    assert str(file) in str(caught.value)
