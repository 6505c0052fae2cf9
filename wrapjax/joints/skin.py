"""Movement of skin over bone: of markers on their bodies, with joint angles and slowly in time.

Skin moves continuously, most of it in phase with the joints near it (Leardini et al. 2005,
doi:10.1016/j.gaitpost.2004.05.002), though not in proportion to their angles. The place of a marker on its
body is therefore the sum of its mean place, of movements with the angles of the joints at that body and with
their squares, with the same amplitudes in all trials, and of a drift: a Gaussian process in time for each
trial with a squared exponential kernel, written in its principal functions (Karhunen-Loeve expansion), so
that its amplitudes are independent. All amplitudes are variables with Gaussian priors; for the posterior of
the joints they are integrated out.
"""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.geometry.marker_model import MarkerModel
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.joints.freed_parameters import FRAME_KINDS, FreedParameter

#: Coordinates that spread less are taken to rest, rad or m.
MIN_SPREAD = np.radians(1.0)
#: Size of the movement with squared angles against that with angles: an assumption without a published
#: figure, as large as the drift. Skin in proportion to the angle and a shifted center differ in that order.
SQUARED_SHARE = 0.3
#: Size of the drift against that of the movement with joint angles.
DRIFT_SHARE = 0.3
#: Correlation time of the drift, s: skin moves at about the frequencies of the motion.
DRIFT_TIME = 0.25
#: Share of the drift's variance that its principal functions must explain.
_EXPLAINED = 0.995
#: Largest number of amplitudes of the drift: a step of the estimation takes time with its third power.
_MOST_AMPLITUDES = 800


class SkinMovement(eqx.Module):
    """Movements of markers on their bodies.

    Parameters
    ----------
    markers, axes, features
        Marker, axis of its body and feature (`angle_features`) of each movement with a joint angle.
    sd
        Prior standard deviation of each movement, m per unit of the feature.
    drifting
        Markers that drift.
    functions
        Number of functions of time of the drift.
    drift_sd
        Prior standard deviation of the drift along each axis of the body, m.
    """

    markers: tuple[int, ...] = eqx.field(static=True)
    axes: tuple[int, ...] = eqx.field(static=True)
    features: tuple[int, ...] = eqx.field(static=True)
    sd: Float[np.ndarray, " movement"]
    drifting: tuple[int, ...] = eqx.field(static=True)
    functions: int = eqx.field(static=True)
    drift_sd: float

    @property
    def count(self) -> int:
        """Number of amplitudes: of movements with angles, then of the drift by function, marker and axis."""
        return len(self.markers) + 3 * self.functions * len(self.drifting)

    def moved(
        self,
        amplitudes: Float[Array | np.ndarray, " amplitude"],
        features: Float[Array | np.ndarray, " feature"],
        drift: Float[Array | np.ndarray, " function"],
        locations: Float[Array | np.ndarray, "marker 3"],
    ) -> Float[Array, "marker 3"]:
        """Move markers on their bodies in one frame.

        Parameters
        ----------
        amplitudes
            Amplitudes in prior standard deviations.
        features
            Functions of the joint angles (`angle_features`).
        drift
            Values of the drift's functions.
        locations
            Mean places of the markers on their bodies, m.
        """
        places, split = jnp.asarray(locations), len(self.markers)
        if split:
            lengths = amplitudes[:split] * self.sd * features[np.array(self.features)]
            places = places.at[np.array(self.markers), np.array(self.axes)].add(lengths)
        if self.functions and self.drifting:
            by_function = amplitudes[split:].reshape(self.functions, len(self.drifting), 3)
            places = places.at[np.array(self.drifting)].add(
                self.drift_sd * jnp.tensordot(drift, by_function, axes=1)
            )
        return places


def skin_movement(
    description: ModelDescription,
    model: MarkerModel,
    parameters: Sequence[FreedParameter],
    spread: Float[np.ndarray, " coordinate"],
    size: float,
    functions: int,
) -> SkinMovement:
    """Build the movements of the markers on bodies at freed joints.

    Parameters
    ----------
    description, model
        Model, and its skeleton with markers.
    parameters
        Freed parameters.
    spread
        Standard deviation of each coordinate of the skeleton over the frames, rad or m.
    size
        Root mean square movement of a marker with the joint angles, m; 0 for none.
    functions
        Number of functions of the drift.
    """
    freed = {parameter.owner for parameter in parameters if parameter.kind in FRAME_KINDS}
    coordinates = model.structure.coordinates
    angles: dict[str, list[int]] = {}
    for joint in description.joints:
        if joint.name in freed and size > 0.0:
            columns = [coordinates.index(name) for name in joint.coordinates if name in coordinates]
            for body in (joint.parent_body, joint.child_body):
                angles.setdefault(body, []).extend(
                    column for column in columns if spread[column] > MIN_SPREAD
                )
    carriers = [model.structure.bodies[carrier] for carrier in model.carriers]
    rows = [
        (marker, axis, column + first, share * size / np.sqrt(3.0 * len(angles[body])))
        for marker, body in enumerate(carriers)
        for first, share in ((0, 1.0), (len(spread), SQUARED_SHARE))
        for column in angles.get(body, ())
        for axis in range(3)
    ]
    markers, axes, columns_of, sds = zip(*rows, strict=True) if rows else ((), (), (), ())
    return SkinMovement(
        markers=tuple(markers),
        axes=tuple(axes),
        features=tuple(columns_of),
        sd=np.array(sds),
        drifting=tuple(range(len(carriers))) if size > 0.0 else (),
        functions=functions if size > 0.0 else 0,
        drift_sd=DRIFT_SHARE * size / np.sqrt(3.0),
    )


def angle_features(
    poses: Float[np.ndarray, "... coordinate"], among: Float[np.ndarray, "frame coordinate"]
) -> Float[np.ndarray, "... feature"]:
    """Functions of the joint angles with which skin moves.

    Parameters
    ----------
    poses
        Poses, rad and m.
    among
        Frames that give the mean and the spread of each coordinate.

    Returns
    -------
    Array
        Each coordinate less its mean and divided by its spread, then the squares of these less one, which are
        zero in the mean. Coordinates that rest have zeros among the squares.
    """
    spread = among.std(axis=0)
    moves = spread > MIN_SPREAD
    angles = (poses - among.mean(axis=0)) / np.where(moves, spread, 1.0)
    return np.concatenate([angles, np.where(moves, angles**2 - 1.0, 0.0)], axis=-1)


def drift_functions(
    times: Sequence[Float[np.ndarray, " _"]], markers: int
) -> Float[np.ndarray, "all_frames function"]:
    """Principal functions of the drift, each of one trial, scaled to independent standard normal amplitudes.

    Parameters
    ----------
    times
        Times of the frames of each trial, s.
    markers
        Number of markers that drift.

    Returns
    -------
    Array
        Functions at the frames of all trials in order. If these would be too many amplitudes, the functions
        of the greatest variance are kept.
    """
    starts = np.cumsum([0, *(len(time) for time in times)])
    columns, variances = [], []
    for first, time in zip(starts, times, strict=False):
        kernel = np.exp(-0.5 * ((time[:, None] - time[None, :]) / DRIFT_TIME) ** 2)
        values, vectors = (array[..., ::-1] for array in np.linalg.eigh(kernel))
        enough = int(np.searchsorted(np.cumsum(values) / values.sum(), _EXPLAINED)) + 1
        for value, vector in zip(values[:enough], vectors.T, strict=False):
            column = np.zeros(starts[-1])
            column[first : first + len(time)] = np.sqrt(value) * vector
            columns.append(column)
            variances.append(value)
    most = max(1, _MOST_AMPLITUDES // (3 * max(markers, 1)))
    kept = np.sort(np.argsort(variances)[::-1][:most])
    return np.stack([columns[place] for place in kept], axis=1)
