"""The methods by which paths wrap round each kind of surface: shortest paths, and OpenSim's paths."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry.surfaces import cylinder, ellipsoid, opensim_ellipsoid, opensim_torus, sphere, torus
from wrapjax.geometry.surfaces.placed_surface import FREE, PlacedSurface, WrapMethod
from wrapjax.geometry.vectors import Vector, safe_inverse, safe_sqrt

#: Kind of a cylinder, the most common one.
CYLINDER = "cylinder"
#: Kinds of surfaces whose shortest paths have a closed form.
CLOSED_FORMS = {CYLINDER, "sphere"}
_BY_METHOD = {method: f"ellipsoid_{method}" for method in opensim_ellipsoid.METHODS}
#: Kinds of surfaces of which `outside` moves points inside; contacts with the others allow for such ends.
MOVED_OUTSIDE = frozenset({"torus", *_BY_METHOD.values()})
#: Kinds of surfaces by OpenSim's classes. An ellipsoid's kind includes the path's method, which OpenSim's
#: path depends on.
_KINDS = {"WrapCylinder": CYLINDER, "WrapSphere": "sphere", "WrapTorus": "torus"}
#: OpenSim's classes of wrap objects that paths wrap round.
SUPPORTED_CLASSES = (*_KINDS, "WrapEllipsoid")

#: Kinds of the surfaces of a path, in its order.
Kinds = tuple[str, ...]


def _distance_from_center(start: Vector, end: Vector, surface: PlacedSurface) -> Float[Array, "*segment"]:
    """Distance of segments from the center of a sphere (m), or of an ellipsoid along its radius there.

    As a segment passes through the center, the shortest path changes from one side to the other: there the
    moment arm jumps. Round an ellipsoid this happens only near the center.
    """
    sizes = surface.sizes
    assert sizes is not None, "only cylinders have none"
    scaled = [Vector(one.x / sizes.x, one.y / sizes.y, one.z / sizes.z) for one in (start, end)]
    way = scaled[1] - scaled[0]
    along = jnp.clip(-scaled[0].dot(way) * safe_inverse(way.dot(way)), 0.0, 1.0)
    distance = surface.radius * (scaled[0] + way * along).norm()
    return jnp.where(surface.side == 0, distance, FREE)


_SPHERE = WrapMethod(sphere.decide_wrapping, sphere.geodesic_contact, side_clearance=_distance_from_center)
_ELLIPSOID = WrapMethod(
    ellipsoid.decide_wrapping,
    ellipsoid.geodesic_contact,
    decided_first=True,
    side_clearance=_distance_from_center,
)

#: Methods for shortest paths, by the surface's kind.
SHORTEST = {
    CYLINDER: WrapMethod(cylinder.decide_wrapping, cylinder.geodesic_contact),
    "sphere": _SPHERE,
    "torus": WrapMethod(torus.decide_wrapping, torus.geodesic_contact, decided_first=True),
    **dict.fromkeys(_BY_METHOD.values(), _ELLIPSOID),
}
_OPENSIM_OTHERS = {
    "sphere": WrapMethod(sphere.decide_wrapping, sphere.opensim_contact),
    **{
        kind: WrapMethod(
            opensim_ellipsoid.decide_wrapping, opensim_ellipsoid.find_contact(method), decided_first=True
        )
        for method, kind in _BY_METHOD.items()
    },
}
#: Methods for OpenSim's paths round a single surface, and round several.
OPENSIM_SINGLE, OPENSIM_SEVERAL = (
    {
        CYLINDER: WrapMethod(cylinder.decide_wrapping, on_cylinder),
        "torus": WrapMethod(
            opensim_torus.decide_wrapping, opensim_torus.find_contact(on_cylinder), always_wrapped=True
        ),
        **_OPENSIM_OTHERS,
    }
    for on_cylinder in (cylinder.spiral_contact, cylinder.iterated_spiral_contact)
)


def kind_of(opensim_class: str, method: str) -> str:
    """Return the kind of a surface from OpenSim's class and the path's method for ellipsoids."""
    if opensim_class == "WrapEllipsoid":
        return _BY_METHOD.get(method, _BY_METHOD["hybrid"])
    return _KINDS[opensim_class]


def clearance(point: Vector, surface: PlacedSurface, kind: str) -> Float[Array, "*point"]:
    """Distance of points in the surface's frame from the surface (m), negative inside."""
    if kind == CYLINDER:
        return safe_sqrt(point.x**2 + point.y**2) - surface.radius
    if kind == "sphere":
        return point.norm() - surface.radius
    return (torus if kind == "torus" else ellipsoid).clearance(point, surface)


def outside(point: Vector, surface: PlacedSurface, kind: str) -> Vector:
    """Move points inside an ellipsoid or a torus to its surface, in the surface's frame (m); others stay."""
    if kind not in MOVED_OUTSIDE:
        return point
    return (torus if kind == "torus" else ellipsoid).outside(point, surface)
