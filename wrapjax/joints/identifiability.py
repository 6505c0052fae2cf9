"""What markers say about freed parameters: posterior spread, and combinations left undetermined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.geometry.model_description import Joint
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


def place_spread(
    joint: Joint, parameters: Sequence[FreedParameter], known: Posterior
) -> dict[str, list[float | None]]:
    """Compute standard deviations of a joint's place in its parent body, scale of the body included.

    Parameters
    ----------
    joint
        Joint of the starting model.
    parameters, known
        Freed parameters and their posterior.

    Returns
    -------
    dict
        ``translation_m`` along, and ``orientation_rad`` about, each axis of the parent body; None where the
        joint's frame is not freed.
    """
    along, about = np.zeros((2, 3, len(parameters)))
    origin, rotation = np.asarray(joint.in_parent.translation), np.asarray(joint.in_parent.rotation)
    for column, entry in enumerate(parameters):
        axes = slice(None) if entry.axis < 0 else entry.axis
        if entry.kind == "scale" and entry.owner == joint.parent_body:
            along[axes, column] = origin[axes]
        elif entry.kind == "parent_translation" and entry.owner == joint.name:
            along[axes, column] = 1.0
        elif entry.kind == "parent_orientation" and entry.owner == joint.name:
            about[:, column] = rotation[:, entry.axis]
    prior = np.array([entry.sd for entry in parameters])
    covariance = known.correlated * np.outer(prior, prior)
    moved = {entry.axis for entry in parameters if _is(entry, joint, "parent_translation")}
    turned = any(_is(entry, joint, "parent_orientation") for entry in parameters)
    translation, orientation = (
        np.sqrt(np.diagonal(rows @ covariance @ rows.T)).tolist() for rows in (along, about)
    )
    return {
        "translation_m": [value if axis in moved else None for axis, value in enumerate(translation)],
        "orientation_rad": [value if turned and value > 0.0 else None for value in orientation],
    }


def _is(entry: FreedParameter, joint: Joint, kind: str) -> bool:
    return entry.kind == kind and entry.owner == joint.name
