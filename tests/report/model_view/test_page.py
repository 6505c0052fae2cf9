"""Defends: the page holds the scene's numbers, opens without a network, and is no place for foreign code."""

import re
from importlib.resources import files

import numpy as np

from tests.osim.bone_file import TETRAHEDRON
from tests.report.model_view.conftest import COORDINATES, FRAMES, MUSCLES, numbers_of
from tests.report.page import Page
from wrapjax.geometry.skeleton.model_description import Pose
from wrapjax.osim.bones import AttachedMesh
from wrapjax.report.model_view.page import render_page
from wrapjax.report.model_view.payload import describe_scene, to_script


def test_page_holds_the_paths_in_every_frame(numbers, scene):
    """Stored as whole steps of 0.05 mm, so that no point is off by more than half a step in x, y or z."""
    content = numbers.content
    assert [one["name"] for one in content["muscles"]] == list(MUSCLES)
    assert content["frames"] == 2 * FRAMES and content["step"] == 5e-5
    root = scene.bodies[scene.root].origin
    np.testing.assert_allclose(numbers.array(content["root"]).reshape(-1, 3), root, atol=1e-6)
    for muscle, paths in scene.paths.items():
        for placement, path in enumerate(paths):
            for frame in range(scene.frames):
                expected = path.frame(frame) - root[frame]
                np.testing.assert_allclose(numbers.path(muscle, placement, frame), expected, atol=2.51e-5)


def test_page_holds_bodies_axes_and_quantities(numbers, scene):
    content = numbers.content
    transforms = numbers.array(content["transforms"]).reshape(len(scene.bodies), scene.frames, 3, 4)
    thigh = content["bodies"].index("femur_l")
    np.testing.assert_allclose(transforms[thigh, :, :, :3], scene.bodies["femur_l"].rotation, atol=1e-6)
    for stored, axis in zip(content["axes"], scene.axes, strict=True):
        np.testing.assert_allclose(
            numbers.array(stored["direction"]).reshape(-1, 3), axis.direction, atol=1e-6
        )
    found = {one["key"]: one for one in content["quantities"]}
    assert list(found) == ["length", "moment_arm", "moment", "gap"]
    assert [one["name"] for one in found["length"]["series"]] == ["before", "after"]
    before, after = (
        numbers.array(one["values"]).reshape(len(MUSCLES), len(COORDINATES), -1)
        for one in found["moment_arm"]["series"]
    )
    for row, muscle in enumerate(MUSCLES):
        np.testing.assert_allclose(before[row], 1e3 * scene.paths[muscle][0].moment_arm, atol=6e-5)
    np.testing.assert_allclose(after[0], 1e3 * scene.paths["psoas_l"][1].moment_arm, atol=6e-5)
    # What calibration did not change is stored once.
    assert np.isnan(after[1:]).all()


def test_page_loads_nothing(page):
    """No element names another file, and the page itself forbids the browser to load any."""
    found = Page(page)
    for tag, attributes in found.elements:
        for name in ("src", "href", "data", "action", "srcset"):
            assert attributes.get(name, "data:").startswith("data:"), (tag, attributes)
    policy = next(
        one["content"] for one in found.all("meta") if one.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy.startswith("default-src 'none'")
    without_library = page.replace(
        files("wrapjax.report.model_view").joinpath("three/three.min.js").read_text(), ""
    )
    # The name of SVG's elements is no address.
    assert set(re.findall(r"https?://[^\s\"'<]+", without_library)) == {"http://www.w3.org/2000/svg"}
    assert "@import" not in page and "url(" not in without_library
    assert len(page) < 2 << 20


def test_library_is_there_with_its_license_and_all_that_the_page_uses(page):
    folder = files("wrapjax.report.model_view")
    text = folder.joinpath("three/LICENSE").read_text(encoding="utf-8")
    assert "MIT License" in text and text in page
    used = set(re.findall(r"THREE\.(\w+)", folder.joinpath("page.js").read_text(encoding="utf-8")))
    exported = set(re.findall(r"\w+", folder.joinpath("three/used.js").read_text(encoding="utf-8")))
    assert used <= exported
    version = re.match(r"three\.js (\d+\.(\d+)\.\d+) ", folder.joinpath("three/README.md").read_text())
    assert f'"{version[2]}"' in folder.joinpath("three/three.min.js").read_text(encoding="utf-8")


def test_text_from_files_stays_text(page, shown, scene):
    """Names come from other people's models: none may end a script or add an element."""
    assert "A leg&#39;s &lt;motion&gt; &lt;/script&gt;" in page and "&lt;b&gt;Note&lt;/b&gt;" in page
    assert "Before &amp; after." in page
    assert "</script" not in to_script({"name": "</script><script>alert(1)</script>\u2028"})
    script = files("wrapjax.report.model_view").joinpath("page.js").read_text(encoding="utf-8")
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b", script)


def test_equal_scenes_give_equal_blocks(described, shown, scene):
    assert describe_scene(shown, scene, (), ())[1] == describe_scene(shown, scene, (), ())[1]
    assert described[0]["coloring"] == "moment_arm"


# ---- Bones


def test_page_says_what_stands_for_bones(shown, tmp_path, monkeypatch):
    (tmp_path / "thigh.vtp").write_text(TETRAHEDRON)
    same = Pose(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0))
    meshes = tuple(
        AttachedMesh(name, "femur_l", same, (1.0, 1.0, 1.0)) for name in ("thigh.vtp", "shank.vtp")
    )
    monkeypatch.setattr("wrapjax.report.model_view.page.attached_meshes", lambda file: meshes)
    without = render_page(shown)
    assert "Geometry/*.vtp) were not found" in without and not numbers_of(without).content["bones"]
    page = render_page(shown, (tmp_path,))
    assert "Bones whose files were not found: shank.vtp." in page
    found = numbers_of(page)
    (bone,) = found.content["bones"]
    assert found.content["bodies"][bone["body"]] == "femur_l"
    assert found.array(bone["triangles"]).size == 12
    # Bones that would make the page too large are left out, which the page says.
    monkeypatch.setattr("wrapjax.report.model_view.page._LARGEST_PAGE", 1000)
    assert "too large for this page" in render_page(shown, (tmp_path,))
