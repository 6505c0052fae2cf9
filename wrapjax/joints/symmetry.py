"""Parameters of left and right that are one unknown: the change of one side is the other's, mirrored."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.joints.freed_parameters import FRAME_KINDS, FreedParameter
from wrapjax.preprocessing.marker_checks import other_side


def symmetric_unknowns(
    parameters: Sequence[FreedParameter], file: str
) -> Float[np.ndarray, "parameter unknown"]:
    """Map unknowns to parameters, those of corresponding joints and bodies of both sides being one unknown.

    In a mirror across the plane of x and y, a translation along z and rotations about x and y change their
    sign. Markers of the two sides are placed by hand, and keep unknowns of their own.

    Parameters
    ----------
    parameters
        Freed parameters.
    file
        File of the settings, for messages.

    Raises
    ------
    InputError
        If the other side of a freed joint or body is not freed alike, or nothing has two sides.
    """
    places = {(entry.kind, entry.owner, entry.axis): place for place, entry in enumerate(parameters)}
    columns, problems, pairs = [], [], 0
    for place, entry in enumerate(parameters):
        column = np.zeros(len(parameters))
        column[place] = 1.0
        other = other_side(entry.owner) if entry.kind in (*FRAME_KINDS, "scale") else entry.owner
        if other != entry.owner:
            partner = places.get((entry.kind, other, entry.axis))
            if partner is None:
                message = f"symmetric sides need '{other}' freed as '{entry.owner}' is, found it not freed"
                problems.append(Problem(file, message, entry.name))
                continue
            if partner < place:
                continue
            pairs += 1
            column[partner] = mirror_sign(entry.kind, entry.axis)
        columns.append(column)
    if not problems and not pairs:
        problems.append(Problem(file, "expected freed joints of both sides for symmetric, found none"))
    if problems:
        raise InputError(problems)
    return np.stack(columns, axis=1)


def mirror_sign(kind: str, axis: int) -> float:
    """Sign of a change of a frame or scale in a mirror across the plane of x and y."""
    if kind == "scale":
        return 1.0
    turned = kind.endswith("orientation")
    return -1.0 if (axis == 2) != turned else 1.0
