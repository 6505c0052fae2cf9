"""What a cause of model error may change, and the forward model from drive to joint moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from . import anatomy, gait
from .leg import Leg
from .muscle import RATE, Constants, activation_shape, twitch_filter, unit_forces
from .person import Person


@dataclass
class View:
    """What an effect may look at in one recording.

    Attributes
    ----------
    person : Person
        The person without effects.
    rec : Recording
        Motion and ground reaction.
    lmt, arms : ndarray
        True lengths and moment arms.
    muscles : Constants
        True constants.
    speeds : tuple of float
        All speeds of the session.
    walking : View, optional
        A recording of walking, in which ranges of angles and lengths are, unless this one is of walking.
    """

    person: Person
    rec: gait.Recording
    lmt: np.ndarray
    arms: np.ndarray
    muscles: Constants
    speeds: tuple[float, ...]
    walking: View | None = None

    @property
    def habit(self) -> View:
        """The recording of walking whose ranges of angles and lengths count."""
        return self.walking or self

    @property
    def flexion(self) -> np.ndarray:
        """Leg coordinates with knee flexion positive, rad."""
        q = self.rec.q.copy()
        q[:, 3] *= self.person.leg.knee_sign
        return q

    @property
    def rate(self) -> np.ndarray:
        """Time derivative of :attr:`flexion`, rad/s."""
        return np.gradient(self.flexion, 1.0 / RATE, axis=0)

    def index(self, name: str) -> int:
        """Return the index of a muscle."""
        return anatomy.NAMES.index(name)


@dataclass
class Measured:
    """Noise-free measurements of one recording; effects change them in place."""

    q: np.ndarray
    pelvis: np.ndarray
    force: np.ndarray
    cop: np.ndarray
    free: np.ndarray


class Effect:
    """A cause of model error; every method does nothing here.

    Attributes
    ----------
    id : str
        Catalogue id, or a name that begins with ``outside_``.
    family : str
        Family.
    parameter, unit : str
        Name and unit of the size parameter.
    limits : tuple of float
        Published range of the absolute size.
    signs : tuple of int
        Admissible signs of the size.
    """

    id = ""
    family = ""
    parameter = "size"
    unit = ""
    limits: tuple[float, float] = (0.0, 1.0)
    signs: tuple[int, ...] = (1,)

    def __init__(self, size: float, rng: np.random.Generator, person: Person) -> None:
        self.size = size
        self.extra: dict[str, float | str | list] = {}
        self.draw(rng, person)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        """Draw what else the effect needs (which muscle, which joint), independent of the size."""

    def true_leg(self, leg: Leg) -> Leg:
        """Change the true geometry."""
        return leg

    def lab_leg(self, leg: Leg) -> Leg:
        """Change the lab's model (geometry or inertia)."""
        return leg

    def muscles(self, c: Constants, view: View) -> Constants:
        """Change true muscle constants."""
        return c

    def drive(self, drive: np.ndarray, view: View) -> np.ndarray:
        """Change the neural drive of each muscle, shape (T, M)."""
        return drive

    def activation(self, a: np.ndarray, view: View) -> np.ndarray:
        """Change the activation, shape (T, M)."""
        return a

    def force(self, force: np.ndarray, a: np.ndarray, c: Constants, view: View) -> np.ndarray:
        """Change the tendon force, shape (T, M)."""
        return force

    def moment(self, force: np.ndarray, view: View) -> np.ndarray | float:
        """Return an additional joint moment, shape (T, 6), knee moment positive along knee flexion."""
        return 0.0

    def measure(self, m: Measured, view: View) -> None:
        """Change measured motion and ground reaction in place."""

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        """Change the envelopes before low-pass and normalisation, shape (T, C)."""
        return envelope

    def report(self, moments: np.ndarray, view: View) -> np.ndarray:
        """Change the moments written by the lab."""
        return moments

    def describe(self) -> dict:
        """Return id, family and parameters for the truth file."""
        return {
            "effect": self.id,
            "family": self.family,
            "parameters": {self.parameter: self.size, "unit": self.unit, **self.extra},
        }


def forward(drive: np.ndarray, view: View, effects: Sequence[Effect] = ()) -> np.ndarray:
    """Return the joint moments of muscles, passive structures and devices.

    Parameters
    ----------
    drive : ndarray
        Drive of the electrodes, shape (T, C).
    view : View
        Recording and person.
    effects : sequence of Effect
        Effects at work.

    Returns
    -------
    ndarray
        Moments along the coordinates, shape (T, 6).
    """
    c = view.muscles
    for e in effects:
        c = e.muscles(c, view)
    each = drive @ anatomy.channel_matrix().T
    for e in effects:
        each = e.drive(each, view)
    a = activation_shape(twitch_filter(each, c.delay, c.twitch), c.shape)
    for e in effects:
        a = np.clip(e.activation(a, view), 0.0, 1.0)
    gain, slack = unit_forces(view.lmt, c)
    force = gain * a + slack
    for e in effects:
        force = e.force(force, a, c, view)
    out = np.einsum("tm,tmk->tk", force, view.arms)
    sign = np.array([1, 1, 1, view.person.leg.knee_sign, 1, 1])
    for e in effects:
        out = out + e.moment(force, view) * sign
    return out
