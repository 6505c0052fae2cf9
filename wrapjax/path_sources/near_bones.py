"""Wrapping surfaces that stay near the bones of their bodies, where surfaces of these bones are given.

A wrap parameter may move a surface away from the bone that it stands for. It is near as long as its distance
from the nearest vertex of the bones of its body exceeds that of the nominal surface by no more than a limit.
Paths as polynomials learn this from samples; with the exact engine the bounds of the wrap parameters are
reduced until it holds everywhere within them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.exact_paths.engine import surfaces_of
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS
from wrapjax.geometry.skeleton.model_description import WrapObject
from wrapjax.geometry.surfaces.wrap_methods import kind_of
from wrapjax.geometry.surrogates.physiological import distance_from_bones
from wrapjax.geometry.surrogates.wrap_bounds import hammersley, parameter_box
from wrapjax.osim.bones import attached_meshes, find_bones
from wrapjax.osim.model import describe_model

# Shares of the bounds that are tried, the largest first; with the last one a surface is held.
_SHARES = tuple(np.arange(20, -1, -1) / 20)
# Samples within the bounds, beside their corners.
_SAMPLES = 96


@dataclass(frozen=True)
class NearBones:
    """Bones of the bodies that carry wraps, and how far a wrap may leave them.

    Parameters
    ----------
    folders
        Folders with the surfaces of bones.
    distance
        Largest increase of a wrap's distance from the bones of its body over that of the nominal wrap, m.
    vertices
        By body with a bone, all vertices of its bones in its frame, m.
    """

    folders: tuple[Path, ...]
    distance: float
    vertices: Mapping[str, Float[np.ndarray, "vertex 3"]]

    def identify(
        self, wrap: WrapObject, samples: Float[np.ndarray, "sample wrap_parameter"]
    ) -> Bool[np.ndarray, " sample"]:
        """Identify samples of a wrap's parameters with which it is near the bones; all if it has no bone."""
        if wrap.body not in self.vertices:
            return np.ones(len(samples), dtype=bool)
        nominal = NOMINAL_PARAMETERS[None, : samples.shape[1]]
        surface = jax.tree.map(lambda leaf: leaf[0], surfaces_of([wrap]))
        distance = distance_from_bones(
            surface,
            kind_of(wrap.kind, "hybrid"),
            self.vertices[wrap.body],
            np.concatenate([nominal, samples]),
        )
        return distance[1:] - distance[0] <= self.distance

    def box_share(self, wrap: WrapObject, translation: float, names: Sequence[str]) -> float:
        """Find by which common factor all bounds of a wrap's parameters are to be reduced.

        Parameters
        ----------
        wrap
            Wrap.
        translation
            Its largest translation along each axis, m.
        names
            Names of its parameters.

        Returns
        -------
        float
            Largest of 1, 0.95, ... at which the wrap is near its bones at every corner of the bounds and at
            96 points between them; 0, which holds the wrap, if there is none.
        """
        lower, upper = parameter_box(translation, wrap.kind, names)
        nominal = NOMINAL_PARAMETERS[: len(names)]
        ends = [sorted({low, high}) for low, high in zip(lower, upper, strict=True)]
        inner = lower + (upper - lower) * hammersley(_SAMPLES, dimensions=len(names))
        steps = np.concatenate([list(product(*ends)), inner]) - nominal
        return next(
            share for share in _SHARES if share == 0.0 or self.identify(wrap, nominal + share * steps).all()
        )


def find_near_bones(model_file: Path, folders: Sequence[Path], distance: float) -> NearBones:
    """Read the bones of the bodies that carry wraps.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    folders
        Folders with the surfaces of bones (``.vtp``) that the model names. Bones without a file do not count.
    distance
        See `NearBones`, m.

    Raises
    ------
    InputError
        If no bone of a body with wraps is found, or a file is damaged.
    """
    carriers = {wrap.body for wrap in describe_model(model_file).wraps}
    meshes = [mesh for mesh in attached_meshes(model_file) if mesh.body in carriers]
    bones, missing = find_bones(meshes, folders)
    if not bones:
        named = f"none of {', '.join(missing)}" if missing else "the model names no bone of a body with wraps"
        places = ", ".join(map(str, folders))
        raise InputError(Problem(places, f"expected surfaces of bones (.vtp), found {named}"))
    vertices = {
        body: np.concatenate([bone.vertices for bone in bones if bone.body == body])
        for body in sorted({bone.body for bone in bones})
    }
    return NearBones(tuple(folders), distance, vertices)
