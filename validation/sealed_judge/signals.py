"""Noise of the recordings: electromyogram process and smooth errors of the joint moments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from .effect import Effect, View
from .muscle import RATE
from .person import Person
from .session import Take, smooth_envelope

#: Correlation lengths of the moment noise, in cycles: of each cycle alone, and common to all cycles.
LENGTH_OWN, LENGTH_COMMON = 0.04, 0.06


def session_peak(takes: Sequence[Take]) -> np.ndarray:
    """Return the largest drive of each electrode over the session, the unit of its envelope."""
    return np.max([t.drive[t.view.rec.kept].max(axis=0) for t in takes], axis=0)


def gamma_noise(rng: np.random.Generator, shape: tuple[int, int], cv: float) -> np.ndarray:
    """Return multiplicative gamma noise of mean 1 that has about the given variation after the 6 Hz filter.

    A sample of the rectified interference signal over 1/RATE s is gamma distributed; the filter passes about
    2 * 6 / RATE of the white variance.
    """
    variance = cv**2 * RATE / (2 * 6.0 * 0.87)
    return rng.gamma(1.0 / variance, variance, shape)


def envelope(
    take: Take,
    peak: np.ndarray,
    effects: Sequence[Effect],
    rng: np.random.Generator | None = None,
    cv: float = 0.0,
) -> np.ndarray:
    """Return the smoothed envelopes in units of each electrode's session peak, shape (T, C).

    Parameters
    ----------
    take : Take
        True state.
    peak : ndarray
        Unit of each electrode.
    effects : sequence of Effect
        Effects on the electromyogram.
    rng : numpy.random.Generator, optional
        Source of noise; none when left out.
    cv : float
        Coefficient of variation of the noise after smoothing.

    Returns
    -------
    ndarray
        Envelopes.
    """
    raw = take.drive / peak
    if rng is not None:
        raw = raw * gamma_noise(rng, raw.shape, cv)
    for e in effects:
        raw = e.emg(raw, take.view)
    return smooth_envelope(raw)


def moment_noise(
    rng: np.random.Generator,
    person: Person,
    views: Sequence[View],
    peak: np.ndarray,
    repeating: np.random.Generator | None = None,
) -> list[np.ndarray]:
    """Return smooth errors of the moments of each recording; part of them repeats in every cycle.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source.
    person : Person
        Gives the level.
    views : sequence of View
        Recordings.
    peak : ndarray
        Largest absolute moment of each coordinate, Nm.
    repeating : numpy.random.Generator, optional
        Source of the part that repeats; the same as of the rest when left out.

    Returns
    -------
    list of ndarray
        Errors (T, 6) of each recording.
    """
    level, share = person.noise["moment"], person.noise["repeatable"]
    grid = 400
    common = gaussian_filter1d(
        (repeating or rng).standard_normal((grid, 6)), grid * LENGTH_COMMON / np.sqrt(2), axis=0, mode="wrap"
    )
    common /= np.sqrt(1.0 / (2 * np.sqrt(np.pi) * grid * LENGTH_COMMON / np.sqrt(2)))
    out = []
    for view in views:
        phase = view.rec.phase
        per_cycle = RATE * np.diff(view.rec.events).mean()
        width = per_cycle * LENGTH_OWN / np.sqrt(2)
        own = gaussian_filter1d(rng.standard_normal((len(phase), 6)), width, axis=0)
        own *= np.sqrt(2 * np.sqrt(np.pi) * width)
        at = np.mod(phase, 1.0) * grid
        low = at.astype(int) % grid
        part = (at - np.floor(at))[:, None]
        repeat = (1 - part) * common[low] + part * common[(low + 1) % grid]
        out.append(level * peak * (np.sqrt(1 - share) * own + np.sqrt(share) * repeat))
    return out
