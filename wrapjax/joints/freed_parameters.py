"""Parameters of a skeleton that markers may personalise, with prior standard deviations and bounds.

Parameters are changes from the starting model, zero at the start: of a joint's frame in its parent or child
body (translation along the body's axes, m; rotation about x, y and z of the frame, each about the axis as
turned by those before, rad), of a body's scale (a share), and of a marker's place on its body (m).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.skeleton.model_description import Joint, ModelDescription

#: Kinds of changes of a joint's frames.
FRAME_KINDS = ("parent_translation", "parent_orientation", "child_translation", "child_orientation")
#: Axes by index.
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class PriorWidths:
    """Prior standard deviations and bounds of freed parameters.

    The widths describe models that were scaled to a person by markers. Translations and markers on bony
    landmarks: errors of joint centres and of palpation, about 5 to 20 mm (Leardini et al. 1999, J Biomech
    32:99; Della Croce et al. 2005, doi:10.1016/j.gaitpost.2004.05.003).
    Orientations: errors of axes from landmarks, 5 to 10 degrees (Della Croce et al. 2005). Scales: spread of
    segment lengths about regressions on stature, about 5 % (de Leva 1996, doi:10.1016/0021-9290(95)00178-6).
    Bounds are those of the NMSM Pipeline's reference settings, 0.05 m and 0.5 rad; scales and markers have
    wide ones.

    Parameters
    ----------
    translation
        Of joint frames, m.
    orientation
        Of joint frames, rad.
    scale
        Of bodies, as a share.
    anatomical_marker, tracking_marker
        Of markers that the model marks as fixed, and of others, m.
    """

    translation: float = 0.01
    orientation: float = np.radians(7.0)
    scale: float = 0.05
    anatomical_marker: float = 0.005
    tracking_marker: float = 0.02


#: Largest changes: translations (m), orientations (rad), scales (share), markers (m).
BOUNDS = {"translation": 0.05, "orientation": 0.5, "scale": 0.4, "marker": 0.2}


@dataclass(frozen=True)
class FreedParameter:
    """One freed parameter.

    Parameters
    ----------
    kind
        One of `FRAME_KINDS`, ``scale`` or ``marker``.
    owner
        Name of the joint, body or marker.
    axis
        0, 1 or 2 for x, y or z; -1 for all three alike (scales).
    sd
        Prior standard deviation.
    lower, upper
        Bounds.
    """

    kind: str
    owner: str
    axis: int
    sd: float
    lower: float
    upper: float

    @property
    def name(self) -> str:
        """Name for messages and tables, such as ``knee_r parent_orientation x``."""
        axis = "" if self.axis < 0 else f" {AXES[self.axis]}"
        return f"{self.owner} {self.kind}{axis}"

    @property
    def unit(self) -> str:
        """Unit: m, rad or 1."""
        return "rad" if self.kind.endswith("orientation") else "1" if self.kind == "scale" else "m"


def frame_parameters(
    joint: str, kind: str, axes: Iterable[int], widths: PriorWidths, bound: float | None = None
) -> list[FreedParameter]:
    """Free a joint's frame along or about some axes."""
    quantity = "orientation" if kind.endswith("orientation") else "translation"
    sd = widths.orientation if quantity == "orientation" else widths.translation
    limit = BOUNDS[quantity] if bound is None else bound
    return [FreedParameter(kind, joint, axis, sd, -limit, limit) for axis in axes]


def scale_parameters(body: str, widths: PriorWidths, *, per_axis: bool) -> list[FreedParameter]:
    """Free a body's scale, one factor for all axes or one for each."""
    axes = range(3) if per_axis else (-1,)
    return [
        FreedParameter("scale", body, axis, widths.scale, -BOUNDS["scale"], BOUNDS["scale"]) for axis in axes
    ]


def marker_parameters(
    description: ModelDescription, marker: str, widths: PriorWidths, axes: Iterable[int] = range(3)
) -> list[FreedParameter]:
    """Free a marker's place on its body."""
    fixed = next(entry.fixed for entry in description.markers if entry.name == marker)
    sd = widths.anatomical_marker if fixed else widths.tracking_marker
    return [FreedParameter("marker", marker, axis, sd, -BOUNDS["marker"], BOUNDS["marker"]) for axis in axes]


def marked_bodies(description: ModelDescription, markers: Sequence[str]) -> dict[str, int]:
    """Count the recorded markers on each body that has some."""
    counts: dict[str, int] = {}
    for marker in description.markers:
        if marker.name in markers:
            counts[marker.body] = counts.get(marker.body, 0) + 1
    return counts


def spanned_joints(description: ModelDescription, markers: Sequence[str]) -> list[str]:
    """Names of the joints with markers enough on both sides: at least three on the next marked bodies.

    The joint of the whole body with ground, and joints that do not move, are not among them.
    """
    counts = marked_bodies(description, markers)
    names = []
    for joint in description.joints:
        moves = any(not _still(description, name) for name in joint.coordinates)
        if joint.parent_body == "ground" or joint.axes is None or not moves:
            continue
        above = _next_marked_above(description, joint.parent_body, counts)
        below = _next_marked_below(description, joint.child_body, counts)
        if min(counts.get(above, 0), max((counts[body] for body in below), default=0)) >= 3:
            names.append(joint.name)
    return names


def check_spanned(
    description: ModelDescription, joints: Sequence[str], markers: Sequence[str], file: str
) -> None:
    """Check that markers lie on both sides of joints, enough for the coordinates between them.

    Raises
    ------
    InputError
        With a sentence for each joint that the model lacks, that no marker spans, or below which there are
        fewer marker coordinates than coordinates of joints.
    """
    by_name = {joint.name: joint for joint in description.joints}
    counts = marked_bodies(description, markers)
    problems = []
    for name in joints:
        if name not in by_name:
            hint = nearest_name(name, tuple(by_name))
            problems.append(Problem(file, "the model has no such joint", f"joint {name}", hint))
            continue
        joint = by_name[name]
        above = _next_marked_above(description, joint.parent_body, counts)
        below = _next_marked_below(description, joint.child_body, counts)
        if not above or not below:
            side = "above" if not above else "below"
            message = f"expected markers on both sides of the joint, found none {side} it"
            problems.append(Problem(file, message, f"joint {name}"))
            continue
        problems += _too_few(description, joint, below, counts, file)
    if problems:
        raise InputError(problems)


def _too_few(
    description: ModelDescription, joint: Joint, below: Sequence[str], counts: dict[str, int], file: str
) -> list[Problem]:
    """Report a joint below which the next marked bodies have too few markers for its coordinates."""
    freedoms = sum(not _still(description, name) for name in joint.coordinates)
    most = max(counts[body] for body in below)
    if 3 * most >= freedoms + 1:
        return []
    body = max(below, key=lambda name: counts[name])
    message = (
        f"expected more coordinates of markers on '{body}' than the {freedoms} coordinates of the joint, "
        f"found {3 * most} of {most} marker{'s' if most != 1 else ''}"
    )
    return [Problem(file, message, f"joint {joint.name}")]


def default_parameters(
    description: ModelDescription,
    markers: Sequence[str],
    joints: Sequence[str],
    widths: PriorWidths,
    *,
    scales: str = "uniform",
    free_markers: bool = True,
) -> list[FreedParameter]:
    """Free the frames of joints, scales of the bodies at them, and the markers on these bodies.

    A frame is not turned about the axis of a single rotation, which would only shift the joint's coordinate.

    Parameters
    ----------
    description
        Model with markers.
    markers
        Names of the recorded markers.
    joints
        Names of the joints.
    widths
        Prior standard deviations.
    scales
        ``none``, ``uniform`` (one factor a body) or ``axes`` (three).
    free_markers
        Whether to free markers.
    """
    by_name = {joint.name: joint for joint in description.joints}
    freed: list[FreedParameter] = []
    for name in joints:
        turned = _orientation_axes(description, by_name[name])
        for kind in FRAME_KINDS:
            axes: Iterable[int] = turned if kind.endswith("orientation") else range(3)
            freed += frame_parameters(name, kind, axes, widths)
    bodies = _bodies_at(description, joints, marked_bodies(description, markers))
    if scales != "none":
        for body in bodies:
            freed += scale_parameters(body, widths, per_axis=scales == "axes")
    if free_markers:
        for marker in description.markers:
            if marker.name in markers and marker.body in bodies:
                freed += marker_parameters(description, marker.name, widths)
    return freed


def with_widths(parameters: Sequence[FreedParameter], factor: float) -> list[FreedParameter]:
    """Multiply all prior standard deviations by a factor; a large one turns priors off."""
    return [replace(parameter, sd=factor * parameter.sd) for parameter in parameters]


def _orientation_axes(description: ModelDescription, joint: Joint) -> tuple[int, ...]:
    """Axes about which a frame is freed: none along a rotation that a coordinate drives one to one."""
    assert joint.axes is not None
    rotations = [
        np.abs(axis.direction)
        for axis in joint.axes
        if axis.kind == "rotation" and axis.coordinate and not _still(description, axis.coordinate)
    ]
    if len(rotations) >= 3:
        return ()
    return tuple(axis for axis in range(3) if all(direction[axis] < 0.9 for direction in rotations))


def _still(description: ModelDescription, name: str) -> bool:
    coordinate = description.coordinate(name)
    return bool(coordinate.locked or coordinate.prescribed)


def _bodies_at(description: ModelDescription, joints: Sequence[str], counts: dict[str, int]) -> list[str]:
    """List the marked bodies next to joints, in the model's order."""
    found: set[str] = set()
    for joint in description.joints:
        if joint.name in joints:
            found |= {_next_marked_above(description, joint.parent_body, counts)}
            found |= set(_next_marked_below(description, joint.child_body, counts))
    order = [joint.child_body for joint in description.joints]
    return [body for body in order if body in found]


def _next_marked_above(description: ModelDescription, body: str, counts: dict[str, int]) -> str:
    """Nearest body with markers from a body towards ground, itself included; empty if there is none."""
    parents = {joint.child_body: joint.parent_body for joint in description.joints}
    while body in parents and body not in counts:
        body = parents[body]
    return body if body in counts else ""


def _next_marked_below(description: ModelDescription, body: str, counts: dict[str, int]) -> list[str]:
    """Nearest bodies with markers from a body away from ground, itself included."""
    if body in counts:
        return [body]
    children = [joint.child_body for joint in description.joints if joint.parent_body == body]
    return [found for child in children for found in _next_marked_below(description, child, counts)]
