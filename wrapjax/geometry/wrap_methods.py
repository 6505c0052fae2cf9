"""The methods by which paths wrap round each kind of surface: shortest paths, and OpenSim's paths."""

from __future__ import annotations

from jaxtyping import Array, Float

from wrapjax.geometry import cylinder, ellipsoid, opensim_ellipsoid, opensim_torus, sphere, torus
from wrapjax.geometry.placed_surface import PlacedSurface, WrapMethod
from wrapjax.geometry.vectors import Vector, safe_sqrt

#: Kind of a cylinder, the most common one.
CYLINDER = "cylinder"
#: Kinds of surfaces whose shortest paths have a closed form.
CLOSED_FORMS = {CYLINDER, "sphere"}
_ELLIPSOIDS = {method: f"ellipsoid_{method}" for method in opensim_ellipsoid.METHODS}
#: Kinds of surfaces by OpenSim's classes. An ellipsoid's kind includes the path's method, which OpenSim's
#: path depends on.
_KINDS = {"WrapCylinder": CYLINDER, "WrapSphere": "sphere", "WrapTorus": "torus"}
#: OpenSim's classes of wrap objects that paths wrap round.
SUPPORTED_CLASSES = (*_KINDS, "WrapEllipsoid")

#: Kinds of the surfaces of a path, in its order.
Kinds = tuple[str, ...]

_SPHERE = WrapMethod(sphere.decide_wrapping, sphere.geodesic_contact)
_ELLIPSOID = WrapMethod(ellipsoid.decide_wrapping, ellipsoid.geodesic_contact, decided_first=True)

#: Methods for shortest paths, by the surface's kind.
SHORTEST = {
    CYLINDER: WrapMethod(cylinder.decide_wrapping, cylinder.geodesic_contact),
    "sphere": _SPHERE,
    "torus": WrapMethod(torus.decide_wrapping, torus.geodesic_contact, decided_first=True),
    **dict.fromkeys(_ELLIPSOIDS.values(), _ELLIPSOID),
}
_OPENSIM_OTHERS = {
    "sphere": WrapMethod(sphere.decide_wrapping, sphere.opensim_contact),
    **{
        kind: WrapMethod(
            opensim_ellipsoid.decide_wrapping, opensim_ellipsoid.find_contact(method), decided_first=True
        )
        for method, kind in _ELLIPSOIDS.items()
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
        return _ELLIPSOIDS.get(method, _ELLIPSOIDS["hybrid"])
    return _KINDS[opensim_class]


def clearance(point: Vector, surface: PlacedSurface, kind: str) -> Float[Array, "*point"]:
    """Distance of points in the surface's frame from the surface (m), negative inside."""
    if kind == CYLINDER:
        return safe_sqrt(point.x**2 + point.y**2) - surface.radius
    if kind == "sphere":
        return point.norm() - surface.radius
    return (torus if kind == "torus" else ellipsoid).clearance(point, surface)
