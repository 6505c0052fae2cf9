"""Quantities that the page draws as curves or as colors: lengths, moment arms, forces, moments, errors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.geometry.surrogates.surrogate import PathSurrogate
from wrapjax.report.model_view.scene import Motion, Scene

#: Axes that a quantity may have besides frames.
MUSCLE, COORDINATE = "muscle", "coordinate"


@dataclass(frozen=True)
class Series:
    """One curve of a quantity for each muscle, coordinate, or both.

    Parameters
    ----------
    name
        Name in the legend.
    values
        Values whose last axis is ``frame``, in the quantity's unit; NaN where there is none.
    style
        ``reference``, ``main``, ``other`` or ``measured``.
    """

    name: str
    values: Float[np.ndarray, "*item frame"]
    style: str


@dataclass(frozen=True)
class Quantity:
    """Quantity over all frames.

    Parameters
    ----------
    key
        Short name.
    title, unit
        Words for the page.
    axes
        Axes of the values before ``frame``: `MUSCLE`, `COORDINATE` or both, in this order.
    series
        Curves.
    colors
        ``sequential`` or ``diverging`` if muscles can be colored by it, else empty.
    curve
        Whether it is drawn as a curve.
    """

    key: str
    title: str
    unit: str
    axes: tuple[str, ...]
    series: tuple[Series, ...]
    colors: str = ""
    curve: bool = True


def path_quantities(scene: Scene, polynomials: Mapping[str, PathSurrogate]) -> tuple[Quantity, ...]:
    """Collect lengths and moment arms, mm, of the drawn paths and of polynomials.

    Parameters
    ----------
    scene
        Scene with the paths.
    polynomials
        Polynomial paths by their name in the legend.
    """
    lengths, arms = [], []
    styles = ("main",) if len(scene.placements) == 1 else ("reference", "main")
    for number, (placement, style) in enumerate(zip(scene.placements, styles, strict=True)):
        # Paths that no placement changes are in the first series only.
        known = [path[number] if number < len(path) else None for path in scene.paths.values()]
        none = np.full((len(scene.coordinates), scene.frames), np.nan)
        length = np.stack([none[0] if path is None else path.length for path in known])
        arm = np.stack([none if path is None else path.moment_arm for path in known])
        lengths.append(Series(placement.name, 1e3 * length, style))
        arms.append(Series(placement.name, 1e3 * arm, style))
    for name, paths in polynomials.items():
        length, arm = _polynomial_paths(scene, paths)
        lengths.append(Series(name, 1e3 * length, "other"))
        arms.append(Series(name, 1e3 * arm, "other"))
    return (
        Quantity("length", "Path length", "mm", (MUSCLE,), tuple(lengths)),
        Quantity("moment_arm", "Moment arm", "mm", (MUSCLE, COORDINATE), tuple(arms), "diverging"),
    )


def _polynomial_paths(
    scene: Scene, paths: PathSurrogate
) -> tuple[Float[np.ndarray, "muscle frame"], Float[np.ndarray, "muscle coordinate frame"]]:
    """Evaluate polynomials over all frames, m; NaN for muscles and coordinates that they lack."""
    poses = np.concatenate([motion.poses for motion in scene.motions])
    angles = poses[:, [scene.coordinates.index(name) for name in paths.coordinates]].T[None]
    state = paths(jnp.asarray(angles), jnp.zeros(angles.shape))
    length = np.full((len(scene.paths), scene.frames), np.nan)
    arm = np.full((len(scene.paths), len(scene.coordinates), scene.frames), np.nan)
    columns = [scene.coordinates.index(name) for name in paths.coordinates]
    for row, muscle in enumerate(scene.paths):
        if muscle in paths.muscles:
            own = paths.muscles.index(muscle)
            length[row] = np.asarray(state.length)[own, 0]
            arm[row, columns] = np.asarray(state.moment_arm)[own, 0]
    return length, arm


def aligned(
    values: Float[np.ndarray, "item frame"], names: Sequence[str], wanted: Iterable[str]
) -> Float[np.ndarray, "wanted frame"]:
    """Put rows of named values into another order; NaN for names without values."""
    rows = {name: row for row, name in enumerate(names)}
    none = np.full(values.shape[1], np.nan)
    return np.stack([values[rows[name]] if name in rows else none for name in wanted])


def gap_errors(
    where: Sequence[Mapping[str, Any]],
    motions: Sequence[Motion],
    speeds: Sequence[float | None],
    coordinates: Sequence[str],
    key: str,
) -> Float[np.ndarray, "coordinate frame"]:
    """Spread the errors of a diagnosis, given by coordinate, phase and speed, over frames, N m.

    Parameters
    ----------
    where
        Entries ``where`` of ``gap.json``.
    motions, speeds
        Gait cycles and their walking speeds, m/s; None where not given.
    coordinates
        Names of the rows of the result.
    key
        ``rms_Nm`` or ``explainable_rms_Nm``.
    """
    rows = []
    for motion, speed in zip(motions, speeds, strict=True):
        errors = np.full((len(coordinates), len(motion.progress)), np.nan)
        for entry in where:
            phase, value = entry.get("phase_percent"), entry.get(key)
            if phase is None or value is None or entry["coordinate"] not in coordinates:
                continue
            if not math.isfinite(value):
                continue
            if entry["speed_m_s"] == speed:
                # The last bin includes the end of the cycle.
                inside = (motion.progress >= phase[0]) & (motion.progress < phase[1] + (phase[1] >= 100.0))
                errors[tuple(coordinates).index(entry["coordinate"]), inside] = value
        rows.append(errors)
    return np.concatenate(rows, axis=1)
