"""What residuals look like when no effect of the catalogue is at work: the null covariance.

A residual is not white noise. It goes on over phases of a cycle, errors of EMG and angles run through the
model into all joints at once, calibrated parameters have given way to it, Hill curves are never a person's
own, and something smooth repeats that nobody can name. An effect must stand out against all of these: where
a term is missing, effects that look like it are found in everyone.

Rows are ordered ``cycle coordinate phase``, the last running fastest. All matrices are in (N m)^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

Signatures = Float[np.ndarray, "amount cycle coordinate phase"]
Matrix = Float[np.ndarray, "row row"]

#: Over how much of a gait cycle a smooth error that repeats goes on alike.
REPEATED_WIDTH = 0.05
#: Correlation of what repeats at two speeds.
ACROSS_SPEEDS = 0.7


@dataclass(frozen=True)
class InputErrors:
    """Errors of what goes into the model, smooth over a cycle and new in each.

    Parameters
    ----------
    signatures
        What the prediction changes by when an input is off by one standard deviation in that phase alone.
    width
        Over how much of a gait cycle an error goes on alike.
    """

    signatures: Float[np.ndarray, "input cycle coordinate phase"]
    width: float


@dataclass(frozen=True)
class MuscleErrors:
    """Errors of muscle forces that depend on the muscle's state, the same in every cycle.

    Parameters
    ----------
    states
        Activation, normalised fiber length and velocity, each divided by the distance at which errors
        become independent.
    arms
        Moment of one unit of error: the moment arm times the maximum isometric force, N m.
    """

    states: Float[np.ndarray, "muscle cycle phase quantity"]
    arms: Float[np.ndarray, "muscle cycle coordinate phase"]


def periodic_kernel(phases: int, width: float) -> Float[np.ndarray, "phase phase"]:
    """Correlation of a smooth function of the gait cycle between equally spaced phases.

    Parameters
    ----------
    phases
        How many; the first is not repeated at the end.
    width
        At which it falls to ``exp(-1/2)``, in gait cycles, where that is small.
    """
    lag = np.subtract.outer(np.arange(phases), np.arange(phases)) / phases
    return np.exp(-0.5 * (np.sin(np.pi * lag) / (np.pi * width)) ** 2)


def within_cycles(blocks: Float[np.ndarray, "cycle own own"]) -> Matrix:
    """Put one block a cycle on the diagonal."""
    cycles, own, _ = blocks.shape
    whole = np.zeros((cycles, own, cycles, own))
    index = np.arange(cycles)
    whole[index, :, index, :] = blocks
    return whole.reshape(cycles * own, cycles * own)


def input_blocks(errors: InputErrors) -> Float[np.ndarray, "cycle own own"]:
    """Run errors of inputs through the model, each cycle's for itself: one block a cycle."""
    _, cycles, coordinates, phases = errors.signatures.shape
    kernel = periodic_kernel(phases, errors.width)
    outer = np.einsum("ickp,iclq->ckplq", errors.signatures, errors.signatures)
    blocks = outer * kernel[None, None, :, None, :]
    return np.asarray(blocks.reshape(cycles, coordinates * phases, coordinates * phases))


def input_covariance(errors: InputErrors) -> Matrix:
    """Give the covariance of all cycles that errors of inputs make."""
    return within_cycles(input_blocks(errors))


def parameter_covariance(signatures: Signatures, prior_sd: Float[np.ndarray, " amount"]) -> Matrix:
    """Give what parameters of this prior could have made of the prediction, all cycles alike."""
    columns = (signatures * prior_sd[:, None, None, None]).reshape(len(prior_sd), -1)
    return columns.T @ columns


def muscle_covariance(errors: MuscleErrors) -> Matrix:
    """Run errors of muscle forces into the joints: alike where a muscle is in a like state."""
    _, cycles, coordinates, phases = errors.arms.shape
    total = np.zeros((cycles * coordinates * phases,) * 2)
    for states, arms in zip(errors.states, errors.arms, strict=True):
        rows = states.reshape(cycles * phases, -1)
        squares = np.sum(rows**2, axis=1)
        distance = np.maximum(squares[:, None] + squares[None] - 2.0 * rows @ rows.T, 0.0)
        alike = np.exp(-0.5 * distance).reshape(cycles, phases, cycles, phases)
        spread = np.broadcast_to(alike[:, None, :, :, None, :], (cycles, coordinates, phases) * 2)
        total += spread.reshape(total.shape) * np.outer(arms.ravel(), arms.ravel())
    return total


def repeated_covariance(
    sizes: Float[np.ndarray, " coordinate"], speeds: Int[np.ndarray, " cycle"], phases: int
) -> Matrix:
    """Give something smooth that repeats in all cycles of a speed, and in part at the other.

    Parameters
    ----------
    sizes
        Its standard deviation at each coordinate, N m.
    speeds
        Of each cycle, counted from 0.
    phases
        How many.
    """
    same = np.where(speeds[:, None] == speeds[None], 1.0, ACROSS_SPEEDS)
    return np.kron(same, np.kron(np.diag(sizes**2), periodic_kernel(phases, REPEATED_WIDTH)))
