"""Path of one straight segment round one ellipsoid as OpenSim 4.6 computes it.

OpenSim keeps the path in one plane, through the segment and a point of the surface. That point is nearest to
the middle of the part of the segment within the ellipsoid (``midpoint``), nearest to the point of the
segment on a plane of symmetry (``axial``), or a mixture of the latter and of a mean over many points of the
segment (``hybrid``). Points of contact have a closed form where the ellipsoid is scaled to a sphere; OpenSim
finds them by iteration to about 1e-4 of the mean semi-axis, so that lengths differ by micrometers. The
length on the surface is the sum of chords of about 1 mm, as in OpenSim.

OpenSim's algorithm was read in its source, and its results are what it is tested against. Not reproduced is
what depends on the path's history.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.surfaces.ellipsoid import decide_wrapping as decide_shortest
from wrapjax.geometry.surfaces.nearest_on_ellipsoid import nearest_in_section, nearest_on_ellipsoid
from wrapjax.geometry.surfaces.placed_surface import (
    HALF_TURN,
    Contact,
    Decision,
    FindContact,
    PlacedSurface,
    over_segments,
)
from wrapjax.geometry.vectors import Vector, safe_inverse, safe_sqrt, stack_components, vector

#: Ways to choose the plane, OpenSim's names.
METHODS = ("hybrid", "midpoint", "axial")

# OpenSim's constants: inside and nearly collinear ends, cosines between which methods are mixed, share of the
# segment near its ends where the axial method fades, points of the mean, length of a chord (m) and most
# chords.
_INSIDE, _COLLINEAR = 1e-4, 1e-4
_FAN_BELOW, _AXIAL_ABOVE = 0.7073, 0.9
_FADE = 0.3
_FAN = np.arange(1, 299) / 300.0
_CHORD, _MOST_CHORDS = 0.001, 499


def decide_wrapping(start: Vector, end: Vector, ellipsoid: PlacedSurface) -> Decision:
    """Decide as OpenSim's ``WrapEllipsoid`` does whether straight segments wrap.

    Parameters
    ----------
    start, end
        Ends of the segments in the ellipsoid's frame (m).
    ellipsoid
        The ellipsoid, of which only the semi-axes are used.
    """
    decision = decide_shortest(start, end, ellipsoid)
    sizes = ellipsoid.sizes
    assert sizes is not None

    def excess(point: Vector) -> Float[Array, "*segment"]:
        return (point.x / sizes.x) ** 2 + (point.y / sizes.y) ** 2 + (point.z / sizes.z) ** 2 - 1.0

    way = start - end
    one = Vector(way.x / sizes.x, way.y / sizes.y, way.z / sizes.z)
    other = Vector(end.x / sizes.x, end.y / sizes.y, end.z / sizes.z)
    quadratic, linear, constant = one.dot(one), 2.0 * one.dot(other), other.dot(other) - 1.0
    discriminant = linear**2 - 4.0 * quadratic * constant
    root, divisor = safe_sqrt(discriminant), safe_inverse(2.0 * quadratic)
    far, near = (root - linear) * divisor, (-root - linear) * divisor
    crossing = (discriminant >= 0.0) & (near > 0.0) & (far < 1.0) & (far > 0.0) & (near < 1.0)
    inside = (excess(start) < -_INSIDE) | (excess(end) < -_INSIDE)
    collinear = jnp.abs(start.unit().dot(end.unit()) - 1.0) < _COLLINEAR
    return replace(decision, inside=inside, mandatory=crossing & ~collinear & ~inside)


def find_contact(method: str) -> FindContact:
    """Return the function that computes contacts as OpenSim does with one of `METHODS`."""
    return _CONTACTS[method]


def _contact(
    start: Vector, end: Vector, ellipsoid: PlacedSurface, decision: Decision, *, method: str
) -> Contact:
    sizes = ellipsoid.sizes
    assert sizes is not None

    def one(start: Float[Array, " 3"], end: Float[Array, " 3"], wraps: Array) -> tuple[Array, ...]:
        dimensions = stack_components(sizes)
        # In place of segments that do not wrap, whose contact is not used, some segment that does is
        # computed.
        scale = 3.0 / jnp.sum(dimensions)
        start = jnp.where(wraps, start, jnp.asarray([-2.0, 0.3, 0.1]) * dimensions)
        end = jnp.where(wraps, end, jnp.asarray([2.0, 0.4, -0.2]) * dimensions)
        return _wrapped(start * scale, end * scale, dimensions * scale, scale, ellipsoid, method)

    ends = stack_components(start), stack_components(end)
    first_points, last_points, length = over_segments(one, start)(*ends, decision.mandatory)
    first, last = vector(first_points), vector(last_points)
    return Contact(
        first=first,
        last=last,
        length=length,
        total=(first - start).norm() + length + (end - last).norm(),
        start_pull=(first - start).unit(),
        end_pull=(end - last).unit(),
        valid=~decision.inside,
        turn=jnp.full_like(length, 0.5 * HALF_TURN),
        off_end=jnp.ones_like(length),
    )


_CONTACTS = {method: partial(_contact, method=method) for method in METHODS}


def _wrapped(
    start: Float[Array, " 3"],
    end: Float[Array, " 3"],
    axes: Float[Array, " 3"],
    scale: Float[Array, ""],
    ellipsoid: PlacedSurface,
    method: str,
) -> tuple[Array, Array, Array]:
    """Compute the points of contact and the length on the surface (m); ends and axes are times ``scale``."""
    way = start - end
    quadratic, linear = jnp.sum((way / axes) ** 2), 2.0 * jnp.sum(way * end / axes**2)
    constant = jnp.sum((end / axes) ** 2) - 1.0
    root = safe_sqrt(linear**2 - 4.0 * quadratic * constant)
    entry = end + (root - linear) / (2.0 * quadratic) * way
    through = -root / quadratic * way
    point, weight, from_entry = _plane_point(entry, through, way, axes, method)
    point, begin, reflected = _on_active_side(point, weight, axes, ellipsoid)
    # OpenSim's iteration for the points of contact begins at this point or where the segment enters and
    # leaves.
    from_entry &= ~reflected
    begins = [jnp.where(from_entry, other, begin) for other in (entry, entry + through)]

    normal = jnp.cross(way, start - point)
    normal = normal * safe_inverse(_norm(normal))
    # Where the ellipsoid is a unit sphere, the plane's section is a circle.
    scaled_normal = normal * axes
    height = jnp.sum(normal * point) * safe_inverse(_norm(scaled_normal))
    scaled_normal = scaled_normal * safe_inverse(_norm(scaled_normal))
    center, radius = height * scaled_normal, safe_sqrt(1.0 - height**2)

    def contact(end: Float[Array, " 3"], begin: Float[Array, " 3"]) -> Float[Array, " 3"]:
        """Tangent point on the side where the iteration begins, seen from the end."""
        toward = end / axes - center
        distance = _norm(toward)
        toward = toward * safe_inverse(distance)
        aside = jnp.cross(scaled_normal, toward)
        side = jnp.where(jnp.sum((begin / axes - center) * aside) >= 0.0, 1.0, -1.0)
        cosine = jnp.minimum(radius * safe_inverse(distance), 1.0)
        around = cosine * toward + side * safe_sqrt(1.0 - cosine**2) * aside
        return axes * (center + radius * around)

    first, last = contact(start, begins[0]), contact(end, begins[1])
    on_surface = [jnp.abs(jnp.sum((one / axes) ** 2) - 1.0) < _INSIDE for one in (start, end)]
    first = jnp.where(on_surface[0], start, first)
    last = jnp.where(on_surface[1], end, last)
    length = _surface_length(first, last, start, end, normal, jnp.sum(normal * point), axes, scale, ellipsoid)
    return first / scale, last / scale, length / scale


def _plane_point(
    entry: Float[Array, " 3"],
    through: Float[Array, " 3"],
    way: Float[Array, " 3"],
    axes: Float[Array, " 3"],
    method: str,
) -> tuple[Float[Array, " 3"], Float[Array, ""], Bool[Array, ""]]:
    """Find the point of the surface that determines the plane.

    Returned are the point, the weight by which a reflected point is moved back to the border, and whether
    points of contact are searched from where the segment enters and leaves.
    """
    cosines = jnp.abs(way) * safe_inverse(_norm(way))
    best = jnp.argmax(cosines)
    cosine = cosines[best]
    unmoved, from_point = jnp.asarray(0.0), jnp.asarray(False)
    if method == "midpoint":
        return nearest_on_ellipsoid(entry + 0.5 * through, axes), unmoved, from_point
    share = -entry[best] / through[best]
    section_point = (entry + share * through).at[best].set(0.0)
    axial = nearest_in_section(section_point, axes, best)
    if method == "axial":
        return axial, unmoved, (share <= 0.0) | (share >= 1.0)
    fade = jnp.clip(jnp.minimum(share, 1.0 - share) / _FADE, 0.0, 1.0)
    faded = _FAN_BELOW + fade * (cosine - _FAN_BELOW)
    cosine = jnp.where((cosine > _FAN_BELOW) & (fade < 1.0), faded, cosine)
    # The mean direction from points of the segment to the surface.
    points = entry[None] + jnp.outer(jnp.asarray(_FAN), through)
    blades = jax.vmap(lambda one: nearest_on_ellipsoid(one, axes))(points) - points
    mean = jnp.sum(blades * safe_inverse(_norm(blades))[:, None], axis=0)
    mean = mean * safe_inverse(_norm(mean))
    fan = nearest_on_ellipsoid(entry + 0.5 * through + mean, axes)
    part = (cosine - _FAN_BELOW) / (_AXIAL_ABOVE - _FAN_BELOW)
    mixed = nearest_on_ellipsoid(part * axial + (1.0 - part) * fan, axes)
    only_fan, only_axial = cosine <= _FAN_BELOW, cosine >= _AXIAL_ABOVE
    point = jnp.where(only_axial, axial, jnp.where(only_fan, fan, mixed))
    # A weight for the axial method alone is also computed by OpenSim, which then does not use it.
    weight = jnp.where(only_axial, unmoved, jnp.where(only_fan, 1.0, 1.0 - part))
    return point, weight, from_point


def _on_active_side(
    point: Float[Array, " 3"], weight: Float[Array, ""], axes: Float[Array, " 3"], ellipsoid: PlacedSurface
) -> tuple[Float[Array, " 3"], Float[Array, " 3"], Bool[Array, ""]]:
    """Reflect the plane's point to the active side and, by a weight, move it back towards the border.

    Returns the point, the point before it was moved back, and whether it was reflected.
    """
    reflected = (ellipsoid.side != 0) & ~ellipsoid.on_side(vector(point))
    axis = jnp.arange(3) == ellipsoid.side_axis
    mirrored = jnp.where(axis, -point, point)
    moved = nearest_on_ellipsoid(jnp.where(axis, -point * (1.0 - weight), point), axes)
    moved = jnp.where(weight > 0.0, moved, mirrored)
    return jnp.where(reflected, moved, point), jnp.where(reflected, mirrored, point), reflected


def _surface_length(
    first: Float[Array, " 3"],
    last: Float[Array, " 3"],
    start: Float[Array, " 3"],
    end: Float[Array, " 3"],
    normal: Float[Array, " 3"],
    height: Float[Array, ""],
    axes: Float[Array, " 3"],
    scale: Float[Array, ""],
    ellipsoid: PlacedSurface,
) -> Float[Array, ""]:
    """Sum of chords between points at equal steps of the angle about a point of the plane."""
    apart = _norm(last - first)
    chords = jnp.clip(jnp.floor(jax.lax.stop_gradient(apart / scale) / _CHORD), 1, _MOST_CHORDS)
    steepest = jnp.argmax(jnp.abs(normal))
    middle = jnp.where(jnp.arange(3) == steepest, height / normal[steepest], 0.0)
    to_first, to_last = first - middle, last - middle
    to_first = to_first * safe_inverse(_norm(to_first))
    to_last = to_last * safe_inverse(_norm(to_last))
    up = jnp.cross(to_first, to_last)
    up = jnp.cross(up * safe_inverse(_norm(up)), to_first)
    angle = jnp.arctan2(jnp.sum(to_last * up), jnp.sum(to_last * to_first))

    def point(number: Float[Array, ""] | float, step: Float[Array, ""]) -> Float[Array, " 3"]:
        direction = jnp.cos(number * step) * to_first + jnp.sin(number * step) * up
        quadratic = jnp.sum((direction / axes) ** 2)
        linear = 2.0 * jnp.sum(direction * middle / axes**2)
        constant = jnp.sum((middle / axes) ** 2) - 1.0
        reach = (safe_sqrt(linear**2 - 4.0 * quadratic * constant) - linear) / (2.0 * quadratic)
        return middle + reach * direction

    near_step = angle / chords
    wrong_way = _doubles_back(first, point(1.0, near_step), start) | _doubles_back(
        last, point(chords - 1.0, near_step), end
    )
    far = (ellipsoid.side != 0) & (chords >= 2.0) & wrong_way
    step = jnp.where(far, (angle - 2.0 * jnp.pi) / chords, near_step)

    def add(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        number, length, before = state
        after = jnp.where(number + 1.0 >= chords, last, point(number + 1.0, step))
        more = number < chords
        length = length + jnp.where(more, _norm(after - before), 0.0)
        return number + 1.0, length, jnp.where(more, after, before)

    _, length, _ = jax.lax.while_loop(
        lambda state: state[0] < chords, add, (jnp.zeros(()), jnp.zeros(()), first)
    )
    return jnp.where(apart / scale < _CHORD, apart, length)


def _doubles_back(
    contact: Float[Array, " 3"], on_surface: Float[Array, " 3"], end: Float[Array, " 3"]
) -> Bool[Array, ""]:
    """Whether a path turns back by more than a right angle at a point of contact."""
    return jnp.sum((end - contact) * (on_surface - contact)) > 0.0


def _norm(vectors: Float[Array, "*vectors 3"]) -> Float[Array, "*vectors"]:
    return safe_sqrt(jnp.sum(vectors**2, axis=-1))
