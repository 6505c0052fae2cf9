"""Path of one straight segment through one torus as OpenSim 4.6 computes it, defects included.

OpenSim replaces the torus by a straight cylinder of the tube's radius, tangent to the ring at its point that
is nearest to the segment, on whose side towards the ring's center paths pass. It searches this point from
both ends of the segment with MINPACK's ``lmdif``, at a relative tolerance of 1e-4. A factor of two in the
residual makes it the nearest point to a ring of twice the radius.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.surfaces import cylinder
from wrapjax.geometry.surfaces.cylinder import CylinderDecision
from wrapjax.geometry.surfaces.placed_surface import Contact, Decision, FindContact, PlacedSurface
from wrapjax.geometry.surfaces.torus import clearance, tangent_cylinder
from wrapjax.geometry.vectors import Vector, safe_inverse, safe_sqrt, where

# Residual's ring over the torus' ring.
_RING_FACTOR = 2.0
# Constants of the search: tolerances of residual and solution, step bound, step of differences, most steps.
_TOLERANCE, _BOUND, _DIFFERENCE, _MOST_STEPS = 1e-4, 0.2, 1.4901161193847656e-08, 100


class OpenSimTorusDecision(Decision):
    """Whether straight path segments wrap round the cylinder in place of a torus."""

    #: The cylinder in the torus' frame.
    cylinder: PlacedSurface
    on_cylinder: CylinderDecision


def decide_wrapping(start: Vector, end: Vector, torus: PlacedSurface) -> OpenSimTorusDecision:
    """Decide as OpenSim's ``WrapTorus`` does whether straight segments wrap.

    Parameters
    ----------
    start, end
        Ends of the segments in the torus' frame (m).
    torus
        The torus.
    """
    sizes = torus.sizes
    assert sizes is not None
    ring = sizes.x
    one, one_distance = _nearest_on_line(start, end, ring)
    other, other_distance = _nearest_on_line(end, start, ring)
    restricted = torus.side != 0
    one_on, other_on = torus.on_side(one), torus.on_side(other)
    both = ~restricted | (one_on == other_on)
    take_one = jnp.where(both, one_distance < other_distance, one_on)
    nearest = where(take_one, one, other)
    placed = tangent_cylinder(nearest, torus)
    on_cylinder = cylinder.decide_wrapping(
        placed.to_surface_frame(start), placed.to_surface_frame(end), placed
    )
    active = ~restricted | one_on | other_on
    start_clearance, end_clearance = clearance(start, torus), clearance(end, torus)
    return OpenSimTorusDecision(
        # OpenSim's outcome is that of a wrap in any case.
        inside=jnp.zeros_like(active),
        mandatory=jnp.zeros_like(active),
        possible=(on_cylinder.mandatory | on_cylinder.possible) & active,
        start_clearance=start_clearance,
        end_clearance=end_clearance,
        increase=jnp.zeros_like(start_clearance),
        cylinder=placed,
        on_cylinder=on_cylinder,
    )


def find_contact(on_cylinder: Callable[..., Contact]) -> FindContact:
    """Return the function that computes a contact with the cylinder in place of a torus.

    Parameters
    ----------
    on_cylinder
        `cylinder.spiral_contact` or `cylinder.iterated_spiral_contact`.
    """
    return _CONTACTS[on_cylinder]


def _contact_by(on_cylinder: Callable[..., Contact]) -> FindContact:
    def contact(start: Vector, end: Vector, torus: PlacedSurface, decision: OpenSimTorusDecision) -> Contact:
        placed = decision.cylinder
        found = on_cylinder(
            placed.to_surface_frame(start), placed.to_surface_frame(end), placed, decision.on_cylinder
        )
        return replace(
            found,
            first=placed.to_body_frame(found.first),
            last=placed.to_body_frame(found.last),
            start_pull=placed.rotate_to_body_frame(found.start_pull),
            end_pull=placed.rotate_to_body_frame(found.end_pull),
            off_end=jnp.ones_like(found.off_end),
        )

    return contact


_CONTACTS = {
    method: _contact_by(method) for method in (cylinder.spiral_contact, cylinder.iterated_spiral_contact)
}


def _nearest_on_line(
    start: Vector, end: Vector, ring: Float[Array, ""]
) -> tuple[Vector, Float[Array, "*segment"]]:
    """Point of the segment's line that OpenSim finds from its start, and its distance from the ring (m)."""
    direction = (end - start).unit()
    along = _searched(start, direction, ring)
    point = start + direction * along
    aside = safe_sqrt(point.x**2 + point.y**2)
    square = point.dot(point) + ring**2 - 2.0 * ring * aside
    return point, safe_sqrt(square)


def _residual(
    along: Float[Array, "*segment"], start: Vector, direction: Vector, ring: Float[Array, ""]
) -> Float[Array, "*segment"]:
    """OpenSim's derivative of the squared distance from the ring by the distance along the line (m)."""
    flat = direction.x**2 + direction.y**2
    toward = start.x * direction.x + start.y * direction.y
    aside = safe_sqrt(along**2 * flat + 2.0 * toward * along + start.x**2 + start.y**2)
    slope = _RING_FACTOR * 2.0 * ring * (flat * along + toward) * safe_inverse(aside)
    return 2.0 * start.dot(direction) + 2.0 * along - slope


def _searched(start: Vector, direction: Vector, ring: Float[Array, ""]) -> Float[Array, "*segment"]:
    """Root of the residual by the steps of ``lmdif``, with the derivative of a root."""
    fixed = jax.lax.stop_gradient((start, direction, ring))

    def residual(along: Float[Array, "*segment"]) -> Float[Array, "*segment"]:
        return _residual(along, *fixed)

    def unfinished(state: tuple[Array, ...]) -> Bool[Array, ""]:
        return jnp.any(~state[4]) & (state[5] < _MOST_STEPS)

    def step(state: tuple[Array, ...]) -> tuple[Array, ...]:
        at, value, scale, bound, done, count = state
        small = _DIFFERENCE * jnp.abs(at)
        small = jnp.where(small == 0.0, _DIFFERENCE, small)
        slope = (residual(at + small) - value) / small
        scale = jnp.where(
            count == 0, jnp.where(slope == 0.0, 1.0, jnp.abs(slope)), jnp.maximum(scale, jnp.abs(slope))
        )
        newton = -value * safe_inverse(slope)
        longest = bound / scale
        # A step up to a tenth beyond the bound is accepted.
        full = scale * jnp.abs(newton) <= 1.1 * bound
        move = jnp.where(full, newton, jnp.sign(newton) * longest)
        damping = jnp.where(
            full, 0.0, jnp.abs(slope * value) * safe_inverse(longest) / scale**2 - (slope / scale) ** 2
        )
        length = scale * jnp.abs(move)
        bound = jnp.where(count == 0, jnp.minimum(bound, length), bound)
        trial = at + move
        trial_value = residual(trial)
        norm, trial_norm = jnp.abs(value), jnp.abs(trial_value)
        actual = jnp.where(0.1 * trial_norm < norm, 1.0 - (trial_norm * safe_inverse(norm)) ** 2, -1.0)
        linear = (jnp.abs(slope * move) * safe_inverse(norm)) ** 2
        damped = damping * (length * safe_inverse(norm)) ** 2
        promised, descent = linear + 2.0 * damped, -(linear + damped)
        ratio = actual * safe_inverse(promised)
        shrink = jnp.where(actual >= 0.0, 0.5, 0.5 * descent * safe_inverse(descent + 0.5 * actual))
        shrink = jnp.where((0.1 * trial_norm >= norm) | (shrink < 0.1), 0.1, shrink)
        narrower = shrink * jnp.minimum(bound, length / 0.1)
        wider = jnp.where((damping == 0.0) | (ratio >= 0.75), length / 0.5, bound)
        new_bound = jnp.where(ratio <= 0.25, narrower, wider)
        accepted = ratio >= 1e-4
        new_at = jnp.where(accepted, trial, at)
        finished = (jnp.abs(actual) <= _TOLERANCE) & (promised <= _TOLERANCE) & (0.5 * ratio <= 1.0)
        finished |= new_bound <= _TOLERANCE * scale * jnp.abs(new_at)
        finished |= value == 0.0
        keep = done | (value == 0.0)
        return (
            jnp.where(keep, at, new_at),
            jnp.where(keep, value, jnp.where(accepted, trial_value, value)),
            scale,
            jnp.where(done, state[3], new_bound),
            done | finished,
            count + 1,
        )

    zeros = jnp.zeros_like(fixed[0].x)
    begin: tuple[Array, ...] = (
        zeros,
        residual(zeros),
        zeros,
        jnp.full_like(zeros, _BOUND),
        zeros > 0.0,
        jnp.asarray(0),
    )
    at, *_ = jax.lax.while_loop(unfinished, step, begin)
    at = jax.lax.stop_gradient(at)
    slope = jax.jvp(residual, (at,), (jnp.ones_like(at),))[1]
    value = _residual(at, start, direction, ring)
    return at - (value - jax.lax.stop_gradient(value)) * safe_inverse(slope)
