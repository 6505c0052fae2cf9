"""What markers say about freed parameters: posterior spread, and combinations left undetermined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.geometry.skeleton.model_description import Joint
from wrapjax.joints.freed_parameters import FreedParameter

#: A parameter is determined if markers reduce its standard deviation below this share of the prior one.
DETERMINED_RATIO = 0.5
#: Components below this share of the largest one are left out of a direction's description.
_SMALL_COMPONENT = 0.3


@dataclass(frozen=True)
class Direction:
    """Combination of parameters that markers do not determine.

    Parameters
    ----------
    information
        Information of the markers along the direction, as a share of the prior's.
    components
        Largest components, in prior standard deviations, by the parameter's name.
    """

    information: float
    components: dict[str, float]

    def __str__(self) -> str:
        """Describe the direction in a line."""
        parts = [f"{value:+.2f} {name}" for name, value in self.components.items()]
        return ", ".join(parts)


@dataclass(frozen=True)
class Posterior:
    """Laplace approximation of the parameters' posterior distribution.

    Parameters
    ----------
    sd
        Posterior standard deviations, in the parameters' units.
    correlated
        Posterior covariance, in prior standard deviations.
    determined
        Whether markers determine each parameter.
    directions
        Combinations of parameters about which the prior says more than the markers, the least known first.
    """

    sd: Float[np.ndarray, " parameter"]
    correlated: Float[np.ndarray, "parameter parameter"]
    determined: Bool[np.ndarray, " parameter"]
    directions: tuple[Direction, ...]


def posterior(
    parameters: Sequence[FreedParameter],
    matrix: Float[np.ndarray, "variable variable"],
    combination: Float[np.ndarray, "parameter unknown"],
) -> Posterior:
    """Compute the posterior of the parameters from the Gauss-Newton matrix of all variables.

    Parameters
    ----------
    parameters
        Freed parameters.
    matrix
        Gauss-Newton matrix at the solution, prior included, of variables in prior standard deviations.
        Variables after the unknowns (movements of skin) are integrated out.
    combination
        Map from unknowns, the first of the variables, to the parameters.
    """
    count = combination.shape[1]
    of_unknowns = np.linalg.inv(0.5 * (matrix + matrix.T))[:count, :count]
    covariance = combination @ of_unknowns @ combination.T
    prior_sd = np.array([parameter.sd for parameter in parameters])
    ratio = np.sqrt(np.diagonal(covariance))
    values, vectors = np.linalg.eigh(of_unknowns)
    vectors = combination @ vectors
    # Along an eigenvector, information of the markers over that of the prior is 1/variance - 1.
    unknown = [place for place in np.argsort(-values) if values[place] > 0.5]
    directions = tuple(
        _direction(parameters, vectors[:, place], 1.0 / values[place] - 1.0) for place in unknown
    )
    return Posterior(ratio * prior_sd, covariance, ratio < DETERMINED_RATIO, directions)


def _direction(
    parameters: Sequence[FreedParameter], vector: Float[np.ndarray, " parameter"], information: float
) -> Direction:
    largest = float(np.abs(vector).max())
    order = [
        place for place in np.argsort(-np.abs(vector)) if abs(vector[place]) >= _SMALL_COMPONENT * largest
    ]
    sign = np.sign(vector[order[0]])
    return Direction(
        max(information, 0.0),
        {parameters[place].name: float(sign * vector[place]) for place in order},
    )


def place_spreads(
    joints: Sequence[Joint], parameters: Sequence[FreedParameter], known: Posterior
) -> dict[str, dict[str, Any]]:
    """Compute how sure the places of joints in their parent bodies are, scales of the bodies included.

    Parameters
    ----------
    joints
        Joints of the starting model whose places or bodies were freed.
    parameters, known
        Freed parameters and their posterior.

    Returns
    -------
    dict
        By name of the joint: standard deviations ``translation_m`` along, and ``orientation_rad`` about, each
        axis of the parent body, None where the joint's frame is not freed; and ``correlation``, by name of
        each joint, of the three translations and three orientations (rows) with those of that joint
        (columns), zero where not freed.
    """
    prior = np.array([entry.sd for entry in parameters])
    covariance = known.correlated * np.outer(prior, prior)
    moved = {joint.name: _movements(joint, parameters) for joint in joints}
    sd = {
        name: np.sqrt(np.einsum("ij,jk,ik->i", rows, covariance, rows).clip(0.0))
        for name, rows in moved.items()
    }
    scaled = {
        name: np.divide(rows, sd[name][:, None], out=np.zeros_like(rows), where=sd[name][:, None] > 0.0)
        for name, rows in moved.items()
    }
    spreads = {}
    for name, values in sd.items():
        places: list[float | None] = [value if value > 0.0 else None for value in values.tolist()]
        spreads[name] = {
            "translation_m": places[:3],
            "orientation_rad": places[3:],
            "correlation": {
                other: (scaled[name] @ covariance @ rows.T).tolist() for other, rows in scaled.items()
            },
        }
    return spreads


def _movements(joint: Joint, parameters: Sequence[FreedParameter]) -> Float[np.ndarray, "6 parameter"]:
    """Differentiate the place of a joint in its parent body by the parameters; zero where it is held."""
    rows = np.zeros((6, len(parameters)))
    origin, rotation = np.asarray(joint.in_parent.translation), np.asarray(joint.in_parent.rotation)
    for column, entry in enumerate(parameters):
        axes = slice(3) if entry.axis < 0 else entry.axis
        if entry.kind == "scale" and entry.owner == joint.parent_body:
            rows[axes, column] = origin[axes]
        elif entry.kind == "parent_translation" and entry.owner == joint.name:
            rows[axes, column] = 1.0
        elif entry.kind == "parent_orientation" and entry.owner == joint.name:
            rows[3:, column] = rotation[:, entry.axis]
    freed = {
        entry.axis for entry in parameters if entry.kind == "parent_translation" and entry.owner == joint.name
    }
    # The axes of a joint whose place is not freed are those of the scaled model.
    rows[[axis for axis in range(3) if axis not in freed]] = 0.0
    return rows
