"""Surfaces of bones: which files a model names, and their content (VTK's ``.vtp``, as OpenSim has them)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float, Int

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.skeleton.model_description import Pose, Triple
from wrapjax.io.xml import read_xml
from wrapjax.osim.loading import import_opensim, load_model
from wrapjax.osim.model import read_pose

#: Largest number of a vertex or of a polygon's corner.
_MOST = 2**31 - 1


@dataclass(frozen=True)
class AttachedMesh:
    """Surface of a bone, as a file that the model names.

    Parameters
    ----------
    file
        Name of the file, as the model has it; usually without a folder.
    body
        Body that carries the surface.
    pose
        Pose of the surface's frame in the body.
    scale
        Factors along the surface's axes.
    """

    file: str
    body: str
    pose: Pose
    scale: Triple


@dataclass(frozen=True)
class Bone:
    """Surface of a bone in the frame of the body that carries it.

    Parameters
    ----------
    body
        Name of the body.
    vertices
        m
    triangles
        Vertices of each triangle.
    """

    body: str
    vertices: Float[np.ndarray, "vertex 3"]
    triangles: Int[np.ndarray, "triangle 3"]


def attached_meshes(model_file: Path | str) -> tuple[AttachedMesh, ...]:
    """List the surfaces that a model attaches to its bodies.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).

    Raises
    ------
    InputError
        If OpenSim cannot load the file as a model.
    """
    opensim = import_opensim()
    model, _ = load_model(model_file)
    found = []
    for component in model.getComponentsList():
        mesh = opensim.Mesh.safeDownCast(component)
        if mesh is None:
            continue
        frame = opensim.PhysicalFrame.safeDownCast(mesh.getFrame())
        if frame is None:
            continue
        scale = mesh.get_scale_factors()
        found.append(
            AttachedMesh(
                file=mesh.get_mesh_file(),
                body=frame.findBaseFrame().getName(),
                pose=read_pose(frame.findTransformInBaseFrame()),
                scale=(scale.get(0), scale.get(1), scale.get(2)),
            )
        )
    return tuple(found)


def geometry_folders(model_file: Path | str) -> tuple[Path, ...]:
    """Folders in which OpenSim's users keep the bones' surfaces, those that exist, nearest first.

    These are the model's folder and ``Geometry`` in it or in the folder above it, and ``Geometry`` of the
    installed OpenSim package and of the installation that ``OPENSIM_HOME`` names.
    """
    import os

    home = Path(model_file).resolve().parent
    places = [home / "Geometry", home, home.parent / "Geometry"]
    package = import_opensim().__file__
    if package is not None:
        places.append(Path(package).parent / "Geometry")
    if installed := os.environ.get("OPENSIM_HOME"):
        places.append(Path(installed) / "Geometry")
    return tuple(place for place in places if place.is_dir())


def find_bones(
    meshes: Sequence[AttachedMesh], folders: Sequence[Path]
) -> tuple[tuple[Bone, ...], tuple[str, ...]]:
    """Read the surfaces that are found in some folder.

    Parameters
    ----------
    meshes
        Surfaces that the model names.
    folders
        Folders to search, in this order.

    Returns
    -------
    bones, missing
        Surfaces that were read, and the names of the files that were not found or are not ``.vtp``.

    Raises
    ------
    InputError
        If a file that is found is damaged.
    """
    bones, missing = [], []
    for mesh in meshes:
        places = [folder / mesh.file for folder in folders]
        file = next((place for place in places if place.is_file()), None)
        if file is None or file.suffix.lower() != ".vtp":
            missing.append(mesh.file)
            continue
        vertices, triangles = read_vtp(file)
        rotation, origin = np.asarray(mesh.pose.rotation), np.asarray(mesh.pose.translation)
        bones.append(Bone(mesh.body, origin + (vertices * mesh.scale) @ rotation.T, triangles))
    return tuple(bones), tuple(dict.fromkeys(missing))


def read_vtp(file: Path) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "triangle 3"]]:
    """Read a surface from a ``.vtp`` file whose numbers are written as text, as in OpenSim's files.

    Returns
    -------
    vertices, triangles
        Vertices in the file's units, and the vertices of each triangle. Polygons are divided into triangles.

    Raises
    ------
    InputError
        If the file is not such a file or is damaged.
    """
    root = read_xml(file, "VTKFile")
    pieces = root.findall("PolyData/Piece")
    vertices, triangles, count = [], [], 0
    for piece in pieces:
        points = _numbers(piece.find("Points/DataArray"), file, "Points").reshape(-1, 3)
        arrays = {entry.get("Name"): entry for entry in piece.findall("Polys/DataArray")}
        corners, ends = (_whole_numbers(arrays.get(name), file, name) for name in ("connectivity", "offsets"))
        fans = _fans(corners, ends, file)
        if fans.size and (fans.min() < 0 or fans.max() >= len(points)):
            raise InputError(Problem(str(file), "has polygons of vertices that it does not hold"))
        vertices.append(points)
        triangles.append(count + fans)
        count += len(points)
    if not count:
        raise InputError(Problem(str(file), "expected a surface (PolyData), found none"))
    return np.concatenate(vertices), np.concatenate(triangles)


def _numbers(array: Element | None, file: Path, name: str) -> Float[np.ndarray, " number"]:
    if array is None:
        raise InputError(Problem(str(file), f"expected a DataArray of {name}, found none"))
    if array.get("format", "ascii") != "ascii":
        message = f"expected numbers as text (format 'ascii'), found '{array.get('format')}'"
        raise InputError(Problem(str(file), message, name, "save it as text, for instance with ParaView"))
    try:
        numbers = np.array((array.text or "").split(), dtype=float)
    except ValueError as error:
        raise InputError(Problem(str(file), f"expected numbers ({error})", name)) from None
    if not np.isfinite(numbers).all() or (name == "Points" and numbers.size % 3):
        raise InputError(Problem(str(file), "expected finite numbers, three for each vertex", name))
    return numbers


def _whole_numbers(array: Element | None, file: Path, name: str) -> Int[np.ndarray, " number"]:
    numbers = _numbers(array, file, name)
    if np.any((numbers < 0) | (numbers > _MOST) | (numbers != np.floor(numbers))):
        raise InputError(Problem(str(file), "expected whole numbers from 0 on", name))
    return numbers.astype(int)


def _fans(
    corners: Int[np.ndarray, " corner"], ends: Int[np.ndarray, " polygon"], file: Path
) -> Int[np.ndarray, "triangle 3"]:
    """Divide convex polygons into triangles that share the first vertex."""
    starts = np.concatenate([[0], ends[:-1]]).astype(int)
    if ends.size and (np.any(ends < starts) or ends[-1] != corners.size):
        raise InputError(Problem(str(file), "expected ascending ends of polygons up to the last", "offsets"))
    sizes = ends - starts
    parts = []
    for size in np.unique(sizes[sizes > 2]).tolist():
        polygons = corners[starts[sizes == size][:, None] + np.arange(size)]
        parts += [polygons[:, [0, second, second + 1]] for second in range(1, size - 1)]
    return np.concatenate(parts) if parts else np.zeros((0, 3), dtype=int)
