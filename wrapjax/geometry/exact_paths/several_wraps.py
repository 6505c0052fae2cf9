"""Paths round several surfaces in one pose: the shortest path with exact derivatives, and OpenSim's path.

Both recompute the contact with each surface from its neighbors in the path, one surface after the other.
`wrap_shortest` repeats this until the contacts no longer move, `wrap_in_parity` as often as OpenSim does. The
surfaces may be on one body or on several, and of several kinds.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.exact_paths.path_on_cylinders import (
    INSIDE,
    NO_WRAP,
    PathOnCylinders,
    PointsAndBodies,
    by_method,
    initial_path,
    knot_owners,
    path_length,
    path_segments,
    refit_wrap,
    surfaces_in_ground,
)
from wrapjax.geometry.exact_paths.wrapping import FREE, WrappedPath
from wrapjax.geometry.surfaces.placed_surface import HALF_TURN, Contact, PlacedSurface, WrapMethod
from wrapjax.geometry.surfaces.points_outside import moved_outside, points_in_range, segment_directions
from wrapjax.geometry.surfaces.wrap_methods import (
    CYLINDER,
    MOVED_OUTSIDE,
    OPENSIM_SEVERAL,
    SHORTEST,
    Kinds,
    clearance,
)
from wrapjax.geometry.vectors import Vector, safe_inverse, stack_components, vector

# The shortest path: most sweeps over all surfaces that determine the order of contacts, movement (m) below
# which the order counts as final, most accelerated steps that then move the contacts, and their tolerance
# (m).
_MAX_SWEEPS = 20
_ORDER_TOLERANCE = 1e-3
_MAX_STEPS = 30
_GEODESIC_TOLERANCE = 1e-13
# Contacts that move by more (m) in a further sweep have not converged.
_LARGEST_MOVE = 1e-11
# OpenSim's constants: most sweeps, and change of length (m) at which it stops.
_OPENSIM_SWEEPS = 8
_OPENSIM_TOLERANCE = 0.0005

#: Number of the kind of each surface, if kinds are not in the order of the path.
Numbers = Int[Array, " wrap"] | None


class Route(NamedTuple):
    """Course of a path in ground's frame.

    Knots are numbered: path points first, then the two ends of each surface's contact.
    """

    #: Numbers of the path's knots in order, padded with -1.
    knots: Int[Array, " place"]
    #: Position of each knot (m).
    position: Float[Array, "knot 3"]
    #: Length of the contact with each surface (m), zero without contact.
    on_surface: Float[Array, " wrap"]
    #: Surfaces in ground's frame.
    surfaces: PlacedSurface
    #: Length and moment arms.
    path: WrappedPath


def wrap_shortest(
    path: PointsAndBodies,
    surfaces: PlacedSurface,
    kinds: Kinds = (),
    numbers: Numbers = None,
) -> WrappedPath:
    """Compute the shortest path round several surfaces, whose moment arms are exactly -dL/dq.

    Parameters
    ----------
    path
        Path points and bodies in one pose.
    surfaces
        Each surface in the frame of the body that carries it.
    kinds
        Kind of each surface; by default all are cylinders. With ``numbers``, the kinds in any order.
    numbers
        Number of each surface's kind, by which paths round different kinds of surfaces share a program.
    """
    return shortest_route(path, surfaces, kinds, numbers).path


def shortest_route(
    path: PointsAndBodies, surfaces: PlacedSurface, kinds: Kinds = (), numbers: Numbers = None
) -> Route:
    """Compute the course of the shortest path round any number of surfaces, in one pose.

    Parameters are those of `wrap_shortest`.
    """
    kinds = _known(kinds, surfaces)
    placed = surfaces_in_ground(path, surfaces)
    clearances = point_clearances(path, placed, kinds, numbers)
    path = moved_outside(path, placed, kinds, numbers)
    route, contacts = _shortest_path(path, surfaces, kinds, numbers)
    if MOVED_OUTSIDE & set(kinds):
        # Points that were moved are no longer inside.
        margins = replace(route.margins, inside=jnp.minimum(route.margins.inside, clearances.min()))
        route = route._replace(margins=margins)
    moving = None if path.moving is None else jnp.append(path.moving, jnp.zeros(2 * len(placed.radius), bool))
    margins_of = (contacts.off_end, contacts.long_wrap)
    wrapped = _wrapped_path(route, path, placed, clearances, *margins_of, moving, contacts.directions)
    return Route(route.knots, route.position, route.on_surface, placed, wrapped)


def wrap_in_parity(
    path: PointsAndBodies,
    surfaces: PlacedSurface,
    kinds: Kinds = (),
    numbers: Numbers = None,
) -> WrappedPath:
    """Compute a path round several surfaces as OpenSim 4.6 does, defects included.

    Parameters
    ----------
    path
        Path points and bodies in one pose.
    surfaces
        Each surface in the frame of the body that carries it.
    kinds
        Kind of each surface; by default all are cylinders. With ``numbers``, the kinds in any order.
    numbers
        Number of each surface's kind, by which paths round different kinds of surfaces share a program.

    Notes
    -----
    ``PathWrapPoint::setLocation`` does not invalidate the cached position in ground. Lengths and directions
    of straight segments therefore use the wrap points of the first sweep in which a surface was touched,
    while forces act at the current wrap points.
    """
    kinds = _known(kinds, surfaces)
    methods = [OPENSIM_SEVERAL[kind] for kind in kinds]
    placed = surfaces_in_ground(path, surfaces)
    points, wraps = path.position.shape[0], surfaces.radius.shape[0]

    def stale(route, cached):
        # The position in ground of a knot that was used before is no longer updated.
        straight_ends = jnp.where(cached[:, None], route.straight_ends, route.position)
        return route._replace(straight_ends=straight_ends)

    def refit_by_numbers(route, cached, order):
        """Refit all surfaces in their order, by a loop over constant numbers of surfaces.

        A number that differs in a batch would evaluate all methods. Therefore both of the first two surfaces
        are refitted in both of their places.
        """
        turns, surfaces_in_turn = (jnp.asarray(values) for values in _turns(wraps))

        def refit(step, state):
            before, after, codes = state
            turn, wrap = turns[step], surfaces_in_turn[step]
            found, code = refit_wrap(path, placed, wrap, before, methods, numbers)
            own = order[turn] == wrap
            after = jax.tree.map(lambda new, old: jnp.where(own, new, old), stale(found, cached), after)
            finished = jnp.append(turns, -1)[step + 1] != turn
            before = jax.tree.map(lambda new, old: jnp.where(finished, new, old), after, before)
            return before, after, jnp.where(own, codes.at[turn].set(code), codes)

        codes = jnp.zeros(wraps, dtype=int)
        route, _, codes = jax.lax.fori_loop(0, turns.size, refit, (route, route, codes))
        return route, codes

    def sweep(state):
        route, cached, order, last_length, count, _ = state
        codes = []
        if numbers is not None:
            route, codes = refit_by_numbers(route, cached, order)
        for turn in range(0 if numbers is not None else wraps):
            # Only the first two surfaces exchange places.
            own = (order[turn], methods[:2]) if turn < 2 else (turn, methods)
            route, code = refit_wrap(path, placed, own[0], route, own[1])
            codes.append(code)
            route = stale(route, cached)
        cached = cached | jnp.any(route.knots[None] == jnp.arange(points + 2 * wraps)[:, None], axis=1)
        length = path_length(route, points)
        done = jnp.abs(length - last_length) < _OPENSIM_TOLERANCE
        swap = (count == 0) & ~done & (codes[0] == NO_WRAP) & (codes[1] == INSIDE)
        order = jnp.where(swap, order.at[:2].set(order[:2][::-1]), order)
        return route, cached, order, length, count + 1, done

    def unfinished(state):
        return ~state[5] & (state[4] < _OPENSIM_SWEEPS)

    none_cached = jnp.zeros(points + 2 * wraps, dtype=bool)
    start = (
        *(initial_path(path, wraps), none_cached, jnp.arange(wraps)),
        *(jnp.asarray(jnp.inf), jnp.asarray(0), jnp.asarray(False)),
    )
    route, *_ = jax.lax.while_loop(unfinished, sweep, start)
    clearances = point_clearances(path, placed, kinds, numbers)
    return _wrapped_path(route, path, placed, clearances, route.margins.off_end, route.margins.long_wrap)


class _Contacts(NamedTuple):
    """Lengths (m) and margins (m, rad; see `Margins`) of a path's contacts with its surfaces."""

    length: Float[Array, " wrap"]
    off_end: Float[Array, " wrap"]
    long_wrap: Float[Array, " wrap"]
    #: Unit vectors along the path where it comes to each surface and leaves it.
    directions: Float[Array, "wrap 2 3"]


def _turns(wraps: int) -> tuple[list[int], list[int]]:
    """List turns, and the surfaces to refit in them: both in the first two turns, later the turn's own."""
    pairs = [(0, 0), (0, 1), (1, 1), (1, 0), *((turn, turn) for turn in range(2, wraps))]
    return [turn for turn, _ in pairs], [wrap for _, wrap in pairs]


def _known(kinds: Kinds, surfaces: PlacedSurface) -> Kinds:
    return kinds or (CYLINDER,) * surfaces.radius.shape[0]


def _shortest_path(
    path: PointsAndBodies, surfaces: PlacedSurface, kinds: Kinds, numbers: Numbers
) -> tuple[PathOnCylinders, _Contacts]:
    """Compute the shortest path, differentiable by points and surfaces."""
    points = path.position.shape[0]
    route = _converged(*jax.lax.stop_gradient((path, surfaces)), kinds, numbers)
    knots = _with_derivatives(route.position[points:], route.knots, path, surfaces, kinds, numbers)
    placed = surfaces_in_ground(path, surfaces)
    again, contacts = _refit_all(knots, route.knots, path, placed, kinds, numbers)
    moved = jnp.max(jnp.abs(jax.lax.stop_gradient(again - knots)))
    unconverged = jnp.where(moved > _LARGEST_MOVE, -HALF_TURN, FREE)
    margins = replace(route.margins, long_wrap=jnp.minimum(route.margins.long_wrap, unconverged))
    position = jnp.concatenate([path.position, again])
    found = route._replace(position=position, straight_ends=position, margins=margins)
    return found._replace(on_surface=contacts.length), contacts


def _converged(
    path: PointsAndBodies, surfaces: PlacedSurface, kinds: Kinds, numbers: Numbers
) -> PathOnCylinders:
    """Determine which surfaces the path touches and in which order, then iterate to convergence."""
    placed = surfaces_in_ground(path, surfaces)
    points, wraps = path.position.shape[0], surfaces.radius.shape[0]
    methods = [SHORTEST[kind] for kind in kinds]

    def sweep(state):
        route, _, count = state
        before = route

        def refit(wrap, route):
            route, _ = refit_wrap(path, placed, wrap, route, methods, numbers)
            return route._replace(straight_ends=route.position)

        route = jax.lax.fori_loop(0, wraps, refit, route)
        moved = jnp.max(jnp.abs(route.position - before.position))
        same = jnp.all(route.knots == before.knots)
        return route, same & (moved < _ORDER_TOLERANCE), count + 1

    def order_unknown(state):
        return ~state[1] & (state[2] < _MAX_SWEEPS)

    start = (initial_path(path, wraps), jnp.asarray(False), jnp.asarray(0))
    route, *_ = jax.lax.while_loop(order_unknown, sweep, start)

    def step(state):
        # Contacts converge linearly: their limit is extrapolated from two sweeps (Aitken).
        contacts, _, count = state
        once, _ = _refit_all(contacts, route.knots, path, placed, kinds, numbers)
        twice, _ = _refit_all(once, route.knots, path, placed, kinds, numbers)
        first, second = once - contacts, twice - once
        factor = jnp.clip(jnp.sum(first * second) * safe_inverse(jnp.sum(first**2)), -0.9, 0.9)
        # After the last extrapolation points would be off the surface by its size.
        moved = jnp.max(jnp.abs(second))
        ahead = jnp.where(moved < _GEODESIC_TOLERANCE, 0.0, factor / (1.0 - factor))
        return twice + ahead * second, moved, count + 1

    def unconverged(state):
        return (state[1] >= _GEODESIC_TOLERANCE) & (state[2] < _MAX_STEPS)

    ordered = (route.position[points:], jnp.asarray(jnp.inf), jnp.asarray(0))
    contacts, moved, _ = jax.lax.while_loop(unconverged, step, ordered)
    # Round surfaces that overlap the contacts may move without end: those of the last sweep are on surfaces.
    # Rounding alone may move them by more than the tolerance.
    contacts = jnp.where(moved < _LARGEST_MOVE, contacts, ordered[0])
    return route._replace(position=jnp.concatenate([path.position, contacts]))


@eqx.filter_custom_jvp
def _with_derivatives(
    contacts: Float[Array, "contact 3"],
    knots: Int[Array, " place"],
    path: PointsAndBodies,
    surfaces: PlacedSurface,
    kinds: Kinds,
    numbers: Numbers,
) -> Float[Array, "contact 3"]:
    """Give converged points of contact their derivatives by points and surfaces.

    Converged points x solve x = T(x, p), where T recomputes all contacts once. By the implicit function
    theorem dx = (1 - dT/dx)^-1 dT/dp dp, so that no iteration is differentiated.
    """
    return contacts


@_with_derivatives.def_jvp
def _with_derivatives_jvp(primals, tangents):
    _, knots, path, surfaces, kinds, numbers = primals
    _, _, path_tangent, surfaces_tangent, _, _ = tangents
    # Not the bare points: second derivatives differentiate this rule, and need the points' own derivatives.
    contacts = _with_derivatives(*primals)

    def refit(x, path, surfaces):
        placed = surfaces_in_ground(path, surfaces)
        return _refit_all(x.reshape(contacts.shape), knots, path, placed, kinds, numbers)[0].ravel()

    flat = contacts.ravel()
    _, moved = eqx.filter_jvp(
        lambda path, surfaces: refit(flat, path, surfaces),
        (path, surfaces),
        (path_tangent, surfaces_tangent),
    )
    by_contacts = jax.jacfwd(refit)(flat, path, surfaces)
    tangent = solve_without_lapack(jnp.eye(flat.size) - by_contacts, moved)
    return contacts, tangent.reshape(contacts.shape)


def solve_without_lapack(
    matrix: Float[Array, "row row"], right_side: Float[Array, " row"]
) -> Float[Array, " row"]:
    """Solve a small system of linear equations by Gauss-Jordan elimination with partial pivoting.

    Batched LAPACK routines of jaxlib 0.10 occupy a thread of XLA's pool while they wait for others of the
    same pool. Second derivatives of a path solve two systems at once, which on two cores may wait for each
    other forever.

    Parameters
    ----------
    matrix, right_side
        Coefficients and right side; a singular matrix gives no finite solution.
    """
    rows = jnp.arange(right_side.size)

    def solved(matrix: Array, right_side: Array) -> Array:
        def eliminate(column: Array, systems: tuple[Array, Array]) -> tuple[Array, Array]:
            left = systems[0]
            below = jnp.where(rows < column, -1.0, jnp.abs(left[:, column]))
            here, pivot = rows == column, rows == jnp.argmax(below)

            def exchanged(values: Array) -> Array:
                difference = jnp.where(pivot, 1.0, 0.0) @ values - values[column]
                return values + jnp.outer(jnp.where(here, 1.0, 0.0) - pivot, difference)

            left, right = (exchanged(values) for values in systems)
            factors, diagonal = jnp.where(here, 0.0, left[:, column]), left[column, column]

            def eliminated(values: Array) -> Array:
                row = values[column] / diagonal
                return jnp.where(here[:, None], row[None], values - jnp.outer(factors, row))

            return eliminated(left), eliminated(right)

        systems = (matrix, right_side[:, None])
        return jax.lax.fori_loop(0, right_side.size, eliminate, systems)[1][:, 0]

    return jax.lax.custom_linear_solve(
        lambda values: matrix @ values,
        right_side,
        solve=lambda _, values: solved(matrix, values),
        transpose_solve=lambda _, values: solved(matrix.T, values),
    )


def _refit_all(
    contacts: Float[Array, "contact 3"],
    knots: Int[Array, " place"],
    path: PointsAndBodies,
    placed: PlacedSurface,
    kinds: Kinds,
    numbers: Numbers,
) -> tuple[Float[Array, "contact 3"], _Contacts]:
    """Recompute the contact with every touched surface once, each between its neighbors in the path."""
    points = path.position.shape[0]
    methods = [SHORTEST[kind] for kind in kinds]

    def refit(position, entry):
        wrap, surface = entry
        rows = points + 2 * wrap + jnp.arange(2)
        touched = jnp.any(knots == rows[0])
        place = jnp.argmax(knots == rows[0])
        before = jnp.maximum(knots[place - 1], 0)
        after = jnp.maximum(knots[jnp.minimum(place + 2, knots.size - 1)], 0)
        start = surface.to_surface_frame(vector(position[before]))
        end = surface.to_surface_frame(vector(position[after]))
        contact = by_method(methods, wrap, numbers, _touch, start, end, surface)
        ends = (surface.to_body_frame(contact.first), surface.to_body_frame(contact.last))
        found = jnp.stack([stack_components(end) for end in ends])
        pulls = (surface.rotate_to_body_frame(pull) for pull in (contact.start_pull, contact.end_pull))
        unchanged = jax.lax.stop_gradient(position[rows])
        moved = position.at[rows].set(jnp.where(touched, found, unchanged))
        return moved, _Contacts(
            length=jnp.where(touched, contact.length, 0.0),
            off_end=jnp.where(touched, contact.off_end, FREE),
            long_wrap=jnp.where(touched, HALF_TURN - contact.turn, FREE),
            directions=jnp.stack([stack_components(pull) for pull in pulls]),
        )

    start = jnp.concatenate([path.position, contacts])
    position, found = jax.lax.scan(refit, start, (jnp.arange(placed.radius.shape[0]), placed))
    return position[points:], found


def _touch(method: WrapMethod, start: Vector, end: Vector, surface: PlacedSurface) -> Contact:
    """Compute the contact of a segment that wraps, also where it would not of its own."""
    decision = method.decide(start, end, surface)
    return method.find_contact(
        start, end, surface, replace(decision, possible=jnp.ones_like(decision.possible))
    )


def _wrapped_path(
    route: PathOnCylinders,
    path: PointsAndBodies,
    placed: PlacedSurface,
    point_clearances: Float[Array, "wrap point"],
    off_end: Float[Array, " wrap"],
    long_wrap: Float[Array, " wrap"],
    moving: Bool[Array, " knot"] | None = None,
    directions: Float[Array, "wrap 2 3"] | None = None,
) -> WrappedPath:
    """Compute length, moment arms (of unit tension along the path) and clearances of a path.

    Moment arms include the motion of ``moving`` points relative to their bodies, which OpenSim leaves out of
    segments with both ends on one body.
    """
    points, wraps = path.position.shape[0], placed.radius.size
    before, after, present, _ = path_segments(route, points)
    body = knot_owners(path, wraps).body
    # A segment with both ends on one body exerts no moment about any joint.
    pulls = body[before] != body[after]
    if moving is not None:
        pulls |= moving[before] | moving[after]
    pulls &= present
    along = segment_directions(route, points, directions)
    # Velocities of the points of contact are those of the body's material there.
    arm = (route.position[points:] - jnp.repeat(path.origin, 2, axis=0))[None]
    turning = jnp.repeat(path.angular, 2, axis=1)
    contact_velocity = jnp.repeat(path.linear, 2, axis=1) + jnp.cross(turning, arm)
    velocity = jnp.concatenate([path.velocity, contact_velocity], axis=1)
    rate = jnp.sum((velocity[:, after] - velocity[:, before]) * along[None], axis=-1)
    return WrappedPath(
        length=path_length(route, points),
        moment_arm=-jnp.sum(jnp.where(pulls[None], rate, 0.0), axis=-1),
        on_surface=route.on_surface,
        margins=jax.tree.map(jnp.min, route.margins),
        clearances=jnp.concatenate([point_clearances.ravel(), off_end, placed.radius * long_wrap]),
    )


def point_clearances(
    path: PointsAndBodies, placed: PlacedSurface, kinds: Kinds, numbers: Numbers
) -> Float[Array, "wrap point"]:
    """Compute the distance of each path point from each surface that it may wrap round (m), negative inside.

    Parameters
    ----------
    path
        Path points and bodies in one pose.
    placed
        Surfaces in ground's frame.
    kinds, numbers
        As in `wrap_shortest`.
    """

    def of_wrap(surface: PlacedSurface, kind: str) -> Float[Array, " point"]:
        return clearance(surface.to_surface_frame(vector(path.position)), surface, kind)

    in_range = points_in_range(path)
    different = list(dict.fromkeys(kinds)) if numbers is None else list(kinds)
    by_kind = [jax.vmap(lambda surface, kind=kind: of_wrap(surface, kind))(placed) for kind in different]
    places = jnp.asarray([different.index(kind) for kind in kinds]) if numbers is None else numbers
    found = by_kind[0] if len(different) == 1 else jnp.stack(by_kind)[places, jnp.arange(places.size)]
    return jnp.where(in_range, found, FREE)
