"""Files of the bones' surfaces that a model names, with their places in the bodies' frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wrapjax.geometry.model_description import Pose, Triple
from wrapjax.osim.loading import import_opensim, load_model
from wrapjax.osim.model import read_pose


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
