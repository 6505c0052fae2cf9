"""Polynomial surrogates of muscle paths over joint coordinates: the outer level of Ao, Fregly et al.

Length, rate and moment arms of a muscle share one set of coefficients (their equations 1 to 3):

    L = sum_k c_k x^p_k,    v = dL/dt,    r_j = -dL/dq_j,    x = (q - center) / half_range

so that velocity and moment arms are consistent with length by construction. All muscles are evaluated by one
padded program.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.paths import PathState

#: Highest total degree of the outer level.
DEGREE = 5
# The number of terms is padded to a multiple of this, so that subjects whose polynomials differ by a few
# terms share compiled programs.
_TERMS = 16


def monomial_exponents(variables: int, degree: int) -> Int[np.ndarray, "term variable"]:
    """List the exponents of all monomials of total degree up to ``degree``, the constant first.

    For degree five there are 126 terms of four variables, 56 of three, 21 of two and 6 of one.
    """
    rows = [row for row in itertools.product(range(degree + 1), repeat=variables) if sum(row) <= degree]
    rows.sort(key=lambda row: (sum(row), tuple(-power for power in row)))
    return np.array(rows, dtype=np.int64).reshape(len(rows), variables)


def monomials(
    exponents: Int[Array, "term variable"], points: Float[Array, "pose variable"]
) -> Float[Array, "pose term"]:
    """Evaluate all monomials at all points."""
    return jnp.prod(_powers(exponents, points), axis=-1)


def monomial_gradients(
    exponents: Int[Array, "term variable"], points: Float[Array, "pose variable"]
) -> Float[Array, "variable pose term"]:
    """Compute derivatives of all monomials by all variables at all points."""
    variables = exponents.shape[-1]
    powers = _powers(exponents, points)
    lowered = _powers(jnp.maximum(exponents - 1, 0), points) * exponents.astype(points.dtype)[None]
    differentiated = jnp.eye(variables, dtype=bool)[:, None, None, :]
    return jnp.prod(jnp.where(differentiated, lowered[None], powers[None]), axis=-1)


def _powers(
    exponents: Int[Array, "term variable"], points: Float[Array, "pose variable"]
) -> Float[Array, "pose term variable"]:
    # Repeated multiplication gives exact derivatives at zero, where those of x**0 are not finite.
    highest = 5
    columns = [jnp.ones_like(points)]
    for _ in range(highest):
        columns.append(columns[-1] * points)
    table = jnp.stack(columns, axis=-1)  # (pose, variable, power)
    variable = jnp.arange(exponents.shape[-1])[None, :]
    return table[:, jnp.broadcast_to(variable, exponents.shape), exponents]


class PathSurrogate(eqx.Module):
    """Paths of all muscles as polynomials of joint coordinates, padded to one shape.

    Variables of a muscle's polynomial are in slots, one for each coordinate that it spans. Unused slots have
    exponent zero, and terms that are padding have coefficient zero.
    """

    #: Names of the muscles.
    muscles: tuple[str, ...] = eqx.field(static=True)
    #: Names of the coordinates.
    coordinates: tuple[str, ...] = eqx.field(static=True)
    #: Number of the coordinate in each slot.
    spans: Int[Array, "muscle slot"]
    #: Whether a slot is used.
    spanned: Bool[Array, "muscle slot"]
    #: Exponent of each slot's variable in each term.
    exponents: Int[Array, "muscle term slot"]
    #: Whether a term is used.
    used: Bool[Array, "muscle term"]
    #: m
    coefficients: Float[Array, "muscle term"]
    #: Center and half range of the fitted poses, rad, by which coordinates are scaled.
    center: Float[Array, " coordinate"]
    half_range: Float[Array, " coordinate"]

    @eqx.filter_jit
    def __call__(
        self,
        angles: Float[Array, "trial coordinate frame"],
        velocities: Float[Array, "trial coordinate frame"],
        coefficients: Float[Array, "muscle term"] | None = None,
    ) -> PathState:
        """Evaluate all paths at all frames.

        Parameters
        ----------
        angles, velocities
            Values (rad) and rates (rad/s) of ``coordinates``.
        coefficients
            Coefficients, m; by default the fitted ones.
        """
        if coefficients is None:
            coefficients = self.coefficients
        trials, _, frames = angles.shape
        poses = jnp.moveaxis(angles, 1, -1).reshape(trials * frames, -1)
        rates = jnp.moveaxis(velocities, 1, -1).reshape(trials * frames, -1)

        def of_one(
            muscle: tuple[Array, Array, Array, Array],
        ) -> tuple[Float[Array, " pose"], Float[Array, "pose coordinate"]]:
            return self._path(*muscle, poses)

        # One after the other, as in `second_derivatives`: all at once would need a gigabyte.
        length, slope = jax.lax.map(of_one, (self.spans, self.spanned, self.exponents, coefficients))
        shape = (len(self.muscles), trials, frames)
        return PathState(
            length=length.reshape(shape),
            velocity=jnp.sum(slope * rates[None], axis=-1).reshape(shape),
            moment_arm=jnp.moveaxis(-slope.reshape(*shape, -1), -1, 2),
        )

    @eqx.filter_jit
    def second_derivatives(
        self, angles: Float[Array, "trial coordinate frame"]
    ) -> Float[Array, "muscle trial coordinate coordinate frame"]:
        """Compute second derivatives of all lengths by the coordinates, at all frames (m/rad^2).

        Parameters
        ----------
        angles
            Values of ``coordinates``, rad.
        """
        trials, _, frames = angles.shape
        poses = jnp.moveaxis(angles, 1, -1).reshape(trials * frames, -1)

        def of_one(
            muscle: tuple[Array, Array, Array, Array],
        ) -> Float[Array, "coordinate pose coordinate"]:
            def along(direction: Float[Array, " coordinate"]) -> Float[Array, "pose coordinate"]:
                change = jnp.broadcast_to(direction, poses.shape)
                return jax.jvp(lambda poses: self._path(*muscle, poses)[1], (poses,), (change,))[1]

            return jax.lax.map(along, jnp.eye(poses.shape[1]))

        # Muscles are evaluated one after the other, because terms times frames of one fit into the CPU's
        # cache.
        found = jax.lax.map(of_one, (self.spans, self.spanned, self.exponents, self.coefficients))
        return jnp.moveaxis(found.reshape(*found.shape[:2], trials, frames, -1), (2, 4), (1, 3))

    def select_muscles(self, names: Sequence[str]) -> PathSurrogate:
        """Select muscles by name, in the given order."""
        rows = np.array([self.muscles.index(name) for name in names])
        fields = ("spans", "spanned", "exponents", "used", "coefficients")
        picked: dict[str, Any] = {
            field: jnp.asarray(np.asarray(getattr(self, field))[rows]) for field in fields
        }
        return replace(self, muscles=tuple(names), **picked)

    def design(
        self, muscle: str, poses: Float[np.ndarray, "pose coordinate"]
    ) -> Float[np.ndarray, "row term"]:
        """Compute the design matrix of a muscle: its length and moment arms per unit of each coefficient.

        Parameters
        ----------
        muscle
            Name of the muscle.
        poses
            Values of ``coordinates``, rad.

        Returns
        -------
        Array
            Rows are the lengths in all poses, then the moment arms about each coordinate that the muscle
            spans, in the order of its slots. Columns are the terms in use.
        """
        row = self.muscles.index(muscle)
        slots, used = self.slots(muscle), np.asarray(self.used[row])
        exponents = np.asarray(self.exponents[row])[used][:, : len(slots)]
        scaled = (poses - np.asarray(self.center)) / np.asarray(self.half_range)
        return _design(exponents, scaled[:, slots], np.asarray(self.half_range)[slots])

    def slots(self, muscle: str) -> list[int]:
        """Find the numbers of the coordinates that a muscle spans, in the order of its slots."""
        row = self.muscles.index(muscle)
        return np.asarray(self.spans[row])[np.asarray(self.spanned[row])].tolist()

    def arrays(self) -> dict[str, np.ndarray]:
        """Convert the surrogate to arrays by name, from which `surrogate_from_arrays` restores it."""
        stored = {name: np.asarray(value) for name, value in vars(self).items() if eqx.is_array(value)}
        return stored | {"muscles": np.array(self.muscles), "coordinates": np.array(self.coordinates)}

    def term_names(self) -> tuple[tuple[str, ...], ...]:
        """Name the terms in use of each muscle, such as ``hip_flexion_l^2*knee_angle_l`` or ``1``.

        A coordinate's name stands for its scaled value, ``(q - center) / half_range``.
        """

        def factor(name: str, power: int) -> str:
            return name if power == 1 else f"{name}^{power}"

        names = []
        for spans, exponents, used in zip(self.spans, self.exponents, self.used, strict=True):
            slots = [self.coordinates[coordinate] for coordinate in np.asarray(spans)]
            rows = np.asarray(exponents)[np.asarray(used)].tolist()
            products = (
                [factor(name, power) for name, power in zip(slots, row, strict=True) if power] for row in rows
            )
            names.append(tuple("*".join(product) or "1" for product in products))
        return tuple(names)

    def mode_derivatives(
        self,
        angles: Float[Array, "trial coordinate frame"],
        velocities: Float[Array, "trial coordinate frame"],
        modes: Float[Array, "muscle term mode"],
    ) -> PathState:
        """Compute the change of all paths per unit of each mode.

        Parameters
        ----------
        angles, velocities
            Values (rad) and rates (rad/s) of ``coordinates``.
        modes
            Coefficients of each mode, m.

        Returns
        -------
        PathState
            The first axes of all leaves are ``muscle mode``.
        """
        return jax.vmap(self, in_axes=(None, None, -1), out_axes=1)(angles, velocities, modes)

    def _path(
        self,
        spans: Int[Array, " slot"],
        spanned: Bool[Array, " slot"],
        exponents: Int[Array, "term slot"],
        coefficients: Float[Array, " term"],
        poses: Float[Array, "pose coordinate"],
    ) -> tuple[Float[Array, " pose"], Float[Array, "pose coordinate"]]:
        """Compute the length of one muscle, and its derivative by every coordinate."""
        scaled = ((poses - self.center[None]) / self.half_range[None])[:, spans]
        length = monomials(exponents, scaled) @ coefficients
        by_slot = (monomial_gradients(exponents, scaled) @ coefficients).T / self.half_range[None, spans]
        slope = jnp.zeros_like(poses).at[:, spans].add(by_slot * spanned[None])
        return length, slope


def surrogate_from_arrays(arrays: Mapping[str, np.ndarray]) -> PathSurrogate:
    """Restore a surrogate from the arrays of `PathSurrogate.arrays`.

    Raises
    ------
    KeyError, TypeError
        If an array is missing.
    """
    muscles, coordinates = (tuple(arrays[name].tolist()) for name in ("muscles", "coordinates"))
    rest = {
        name: jnp.asarray(value) for name, value in arrays.items() if name not in ("muscles", "coordinates")
    }
    return PathSurrogate(muscles, coordinates, **rest)


def fit_surrogate(
    muscles: Sequence[str],
    coordinates: Sequence[str],
    spanned: dict[str, tuple[str, ...]],
    poses: Float[np.ndarray, "pose coordinate"],
    length: Float[np.ndarray, "pose muscle"],
    moment_arm: Float[np.ndarray, "pose coordinate muscle"],
    *,
    degree: int = DEGREE,
    tolerance: float = 0.05,
) -> PathSurrogate:
    """Fit length and all moment arms of each muscle by polynomials with shared coefficients.

    All terms up to ``degree`` are candidates of a linear least-squares fit. Terms are then removed by
    backward elimination: the term whose removal increases the squared error least goes first, while the
    training error stays within ``tolerance`` of that of all terms. The constant is never removed. Ao, Fregly
    et al. do not publish their rule; they report that 41 of the 56 terms of the iliacus were kept.

    Parameters
    ----------
    muscles, coordinates
        Names along the axes of the data.
    spanned
        Names of the coordinates that each muscle depends on.
    poses
        Values of the coordinates, rad.
    length, moment_arm
        Muscle-tendon lengths and moment arms, m, with equal weights in the least squares.
    degree
        Highest total degree.
    tolerance
        Allowed relative increase of the root mean square error by elimination.
    """
    center = 0.5 * (poses.max(axis=0) + poses.min(axis=0))
    half_range = np.maximum(0.5 * (poses.max(axis=0) - poses.min(axis=0)), 1e-3)
    scaled = (poses - center) / half_range
    fits = []
    for index, muscle in enumerate(muscles):
        slots = [coordinates.index(name) for name in spanned[muscle] if name in coordinates]
        exponents = monomial_exponents(len(slots), degree)
        design = _design(exponents, scaled[:, slots], half_range[slots])
        target = np.concatenate([length[:, index], *moment_arm[:, slots, index].T])
        keep, coefficients = _fit_pruned(design, target, tolerance)
        fits.append((slots, exponents[keep], coefficients))
    width = max(len(slots) for slots, _, _ in fits)
    terms = _TERMS * math.ceil(max(len(exponents) for _, exponents, _ in fits) / _TERMS)
    count = len(fits)
    spans = np.zeros((count, width), dtype=np.int64)
    in_use = np.zeros((count, width), dtype=bool)
    padded_exponents = np.zeros((count, terms, width), dtype=np.int64)
    padded_coefficients = np.zeros((count, terms))
    used = np.zeros((count, terms), dtype=bool)
    for index, (slots, exponents, coefficients) in enumerate(fits):
        spans[index, : len(slots)] = slots
        in_use[index, : len(slots)] = True
        padded_exponents[index, : len(exponents), : len(slots)] = exponents
        padded_coefficients[index, : len(exponents)] = coefficients
        used[index, : len(exponents)] = True
    return PathSurrogate(
        muscles=tuple(muscles),
        coordinates=tuple(coordinates),
        spans=jnp.asarray(spans),
        spanned=jnp.asarray(in_use),
        exponents=jnp.asarray(padded_exponents),
        used=jnp.asarray(used),
        coefficients=jnp.asarray(padded_coefficients),
        center=jnp.asarray(center),
        half_range=jnp.asarray(half_range),
    )


def _design(
    exponents: Int[np.ndarray, "term slot"],
    scaled: Float[np.ndarray, "pose slot"],
    half_range: Float[np.ndarray, " slot"],
) -> Float[np.ndarray, "row term"]:
    """Compute lengths, then moment arms about each slot, per unit of each term."""
    # Jitted, because without it each operation is compiled separately.
    values = np.asarray(jax.jit(monomials)(exponents, scaled))
    gradients = np.asarray(jax.jit(monomial_gradients)(exponents, scaled))
    return np.concatenate([values, *(-gradients / half_range[:, None, None])])


def _fit_pruned(
    design: Float[np.ndarray, "row term"], target: Float[np.ndarray, " row"], tolerance: float
) -> tuple[Int[np.ndarray, " kept"], Float[np.ndarray, " kept"]]:
    """Solve least squares with backward elimination; the first column is never removed.

    Removal of column k increases the squared error by ``c_k**2 / S_kk`` with ``S = (A'A)^-1``. The remaining
    coefficients and S follow by a rank-one update.
    """
    q, r = np.linalg.qr(design)
    coefficients = np.linalg.solve(r, q.T @ target)
    inverse = np.linalg.inv(r)
    inverse = inverse @ inverse.T
    full_error = float(np.sum((target - design @ coefficients) ** 2))
    # For a path that is itself a polynomial the error is round-off, which must not prevent elimination.
    floor = len(target) * (1e-7) ** 2
    budget = (1.0 + tolerance) ** 2 * max(full_error, floor) - full_error
    keep = np.arange(design.shape[1])
    spent = 0.0
    while len(keep) > 1:
        rise = coefficients[1:] ** 2 / np.diag(inverse)[1:]
        drop = 1 + int(np.argmin(rise))
        if spent + rise[drop - 1] > budget:
            break
        spent += float(rise[drop - 1])
        column = inverse[:, drop]
        coefficients = np.delete(coefficients - column * (coefficients[drop] / column[drop]), drop)
        inverse = inverse - np.outer(column, column) / column[drop]
        inverse = np.delete(np.delete(inverse, drop, axis=0), drop, axis=1)
        keep = np.delete(keep, drop)
    # The updates accumulate round-off, therefore the remaining terms are fitted once more.
    return keep, np.linalg.lstsq(design[:, keep], target, rcond=None)[0]
