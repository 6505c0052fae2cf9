"""Data of the page: a JSON object, and one compressed block of numbers that it refers to."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.osim.bones import Bone
from wrapjax.report.model_view.quantities import Quantity
from wrapjax.report.model_view.scene import MusclePath, Scene
from wrapjax.report.model_view.shown import Shown
from wrapjax.report.model_view.wrap_shapes import WrapShape

#: Step of stored positions, m: they are whole numbers of 16 bits, relative to the root body's origin.
POSITION_STEP = 5e-5
_LARGEST = 32_000
#: Added to the stored surface of a vertex that is a path point.
_PATH_POINT = 128


class Block:
    """Arrays in one block of bytes; each is referred to by its type, offset and number of elements."""

    def __init__(self) -> None:
        self._content = bytearray()

    def add(self, values: np.ndarray, kind: str) -> dict[str, Any]:
        """Append an array as ``int16``, ``uint16``, ``uint32``, ``uint8`` or ``float32``, and refer to it."""
        self._content += bytes(-len(self._content) % 4)
        array = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
        reference = {"type": kind, "at": len(self._content), "count": int(array.size)}
        self._content += array.tobytes()
        return reference

    def encoded(self) -> str:
        """Compress (gzip) and encode (base64)."""
        # Equal results give equal pages.
        return base64.b64encode(gzip.compress(bytes(self._content), compresslevel=9, mtime=0)).decode()


def describe_scene(
    shown: Shown, scene: Scene, quantities: Sequence[Quantity], bones: Sequence[Bone]
) -> tuple[dict[str, Any], str]:
    """Describe what the page draws.

    Returns
    -------
    content, block
        JSON object, and the encoded block that its references point into.
    """
    block = Block()
    root = scene.bodies[scene.root].origin
    positions = _Positions(block, scene, root)
    bodies = list(scene.bodies)
    content = {
        "frames": scene.frames,
        "coordinates": scene.coordinates,
        "motions": _motions(scene),
        "root": block.add(root, "float32"),
        "root_body": scene.root,
        "bodies": bodies,
        "transforms": block.add(_transforms(scene, root), "float32"),
        "bones": [
            {"body": bodies.index(bone.body), **_mesh(block, bone.vertices, bone.triangles)}
            for bone in bones
            if bone.body in bodies
        ],
        "sticks": [
            {"body": bodies.index(body), "ends": [line.round(5).tolist() for line in lines]}
            for body, lines in scene.sticks.items()
        ],
        "axes": [
            {
                "coordinate": scene.coordinates.index(axis.coordinate),
                "joint": axis.joint,
                "before": axis.before,
                "center": block.add(axis.center - root, "float32"),
                "direction": block.add(axis.direction, "float32"),
            }
            for axis in scene.axes
        ],
        "placements": [placement.name for placement in scene.placements],
        "wraps": [
            {"name": name, "shapes": [_wrap(block, bodies, shape) for shape in shapes]}
            for name, shapes in scene.wraps.items()
        ],
        "muscles": [
            {
                "name": name,
                "wraps": paths[0].wraps,
                "paths": [positions.path(path) for path in paths],
            }
            for name, paths in scene.paths.items()
        ],
        "step": positions.step,
        "quantities": [_quantity(block, quantity) for quantity in quantities],
        "coloring": shown.coloring,
    }
    return content, block.encoded()


def to_script(content: dict[str, Any]) -> str:
    """Write JSON that can stand in a ``<script>`` element, which no text in it can end."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


class _Positions:
    """Writes paths as whole numbers of steps from the root body's origin in the same frame."""

    def __init__(self, block: Block, scene: Scene, root: Float[np.ndarray, "frame 3"]):
        self._block, self._root = block, root
        paths = [path for own in scene.paths.values() for path in own]
        farthest = max((float(np.abs(self._relative(path)).max()) for path in paths), default=0.0)
        self.step = max(POSITION_STEP, farthest / _LARGEST)

    def path(self, path: MusclePath) -> dict[str, Any]:
        surface = path.contact + 1 + np.where(path.is_point, _PATH_POINT, 0)
        return {
            "counts": self._block.add(path.counts, "uint16"),
            "vertices": self._block.add((self._relative(path) / self.step).round(), "int16"),
            "surface": self._block.add(surface, "uint8"),
        }

    def _relative(self, path: MusclePath) -> Float[np.ndarray, "vertex 3"]:
        return path.vertices - np.repeat(self._root, path.counts, axis=0)


def _motions(scene: Scene) -> list[dict[str, Any]]:
    described, first = [], 0
    for motion in scene.motions:
        described.append(
            {
                "name": motion.name,
                "first": first,
                "progress": motion.progress.round(3).tolist(),
                "unit": motion.unit,
                "time": motion.time.round(4).tolist(),
            }
        )
        first += len(motion.poses)
    return described


def _transforms(scene: Scene, root: Float[np.ndarray, "frame 3"]) -> Float[np.ndarray, "body frame 3 4"]:
    """Rotation and origin of each body in each frame, relative to the root body's origin."""
    return np.stack(
        [
            np.concatenate([motion.rotation, (motion.origin - root)[:, :, None]], axis=2)
            for motion in scene.bodies.values()
        ]
    )


def _mesh(block: Block, vertices: np.ndarray, triangles: np.ndarray) -> dict[str, Any]:
    return {"vertices": block.add(vertices, "float32"), "triangles": block.add(triangles, "uint32")}


def _wrap(block: Block, bodies: list[str], shape: WrapShape) -> dict[str, Any]:
    return {
        "body": bodies.index(shape.body) if shape.body in bodies else -1,
        **_mesh(block, shape.vertices, shape.triangles),
        "lines": block.add(shape.lines, "uint32"),
    }


def _quantity(block: Block, quantity: Quantity) -> dict[str, Any]:
    return {
        "key": quantity.key,
        "title": quantity.title,
        "unit": quantity.unit,
        "axes": quantity.axes,
        "colors": quantity.colors,
        "curve": quantity.curve,
        "series": [
            # Rounded, because digits of rounding errors cannot be compressed.
            {"name": one.name, "style": one.style, "values": block.add(one.values.round(4), "float32")}
            for one in quantity.series
        ],
    }
