"""Causes in muscle and tendon."""

from __future__ import annotations

import numpy as np

from . import anatomy
from .curves import active, passive, tendon, velocity
from .effect import Effect, View
from .muscle import RATE, Constants, fiber
from .person import Person

PLANTAR = ("soleus", "med_gas", "lat_gas")
GROUPS = {
    "plantarflexors": PLANTAR,
    "hamstrings": ("semimem", "semiten", "bifemlh"),
    "quadriceps": ("rect_fem", "vas_med", "vas_int", "vas_lat"),
    "hip_flexors": ("iliacus", "psoas", "rect_fem", "tfl"),
    "gluteals": ("glut_med1", "glut_med2", "glut_med3", "glut_max1", "glut_max2", "glut_max3"),
}


def pick(rng: np.random.Generator, names: tuple[str, ...]) -> tuple[str, list[int]]:
    """Draw a muscle group and return its name and the indices of its muscles."""
    name = names[int(rng.integers(len(names)))]
    return name, [anatomy.NAMES.index(m) for m in GROUPS[name]]


def elastic_force(a: np.ndarray, lmt: np.ndarray, c: Constants, strain: float, rows: list[int]) -> np.ndarray:
    """Return tendon forces of some muscles in equilibrium with an elastic tendon.

    The force balance with slight fiber damping (0.01) is integrated by implicit Euler steps of one frame,
    each solved by bisection.  The recording is cut into pieces that march side by side, each after 0.3 s of
    run-in.

    Parameters
    ----------
    a, lmt : ndarray
        Activation and muscle-tendon length of those muscles, shape (T, m).
    c : Constants
        Constants of all muscles.
    strain : float
        Tendon strain at the maximum isometric force.
    rows : list of int
        Indices of those muscles.

    Returns
    -------
    ndarray
        Tendon force, N, shape (T, m).
    """
    lo, ls, speed = c.lo[rows], c.ls[rows], c.lo[rows] * c.vmax[rows] / RATE
    thick = lo * np.sin(c.pennation[rows])
    own = {k: (v[rows] if isinstance(v, np.ndarray) else v) for k, v in vars(c.curves).items()}
    curves = c.curves.with_(**own)
    piece, run_in = 60, 60
    starts = np.arange(0, len(a), piece)
    frames = np.clip(starts[:, None] - run_in + np.arange(piece + run_in), 0, len(a) - 1)

    def excess(s: np.ndarray, t: np.ndarray, last: np.ndarray | None) -> np.ndarray:
        length = np.hypot(s, thick)
        v = np.zeros_like(length) if last is None else (length - last) / speed
        muscle = (
            a[t] * active(length / lo, curves) * velocity(v, curves) + passive(length / lo, curves) + 0.01 * v
        )
        return muscle * s / length - tendon((lmt[t] - s) / ls - 1.0, np.array(strain))

    force, last, s = np.empty_like(lmt), None, None
    for k in range(frames.shape[1]):
        t = frames[:, k]
        top = lmt[t] - 0.98 * ls
        low = 0.1 * lo + 0 * top if s is None else np.clip(s - 0.08 * lo, 0.1 * lo, top)
        high = top if s is None else np.clip(s + 0.08 * lo, 0.1 * lo, top)
        for _ in range(22 if s is None else 14):
            middle = 0.5 * (low + high)
            above = excess(middle, t, last) > 0
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        s = 0.5 * (low + high)
        last = np.hypot(s, thick)
        if k >= run_in:
            at = starts + k - run_in
            inside = at < len(a)
            force[at[inside]] = tendon((lmt[t] - s) / ls - 1.0, np.array(strain))[inside]
    return c.fmax[rows] * force


class TendonCompliance(Effect):
    """Elastic tendons, in equilibrium with the fibers."""

    id, family, parameter, unit = "tendon_compliance", "tendon", "strain_at_fmax", "1"
    limits = (0.005, 0.10)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.group, self.rows = pick(rng, ("plantarflexors", "quadriceps", "hamstrings"))
        self.extra = {"group": self.group}

    def force(self, force: np.ndarray, a: np.ndarray, c: Constants, view: View) -> np.ndarray:
        out = force.copy()
        out[:, self.rows] = elastic_force(a[:, self.rows], view.lmt[:, self.rows], c, self.size, self.rows)
        return out


class SlowFibers(Effect):
    """A slow-fiber share lowers maximum velocity; the curve follows linearly in the share."""

    id, family, parameter, unit = "slow_fibers", "muscle", "relative_loss_of_vmax", "1"
    limits = (0.1, 0.75)

    def muscles(self, c: Constants, view: View) -> Constants:
        return c.with_(vmax=c.vmax * (1 - self.size))


class ActivationLength(Effect):
    """The optimal length grows as activation falls, exponentially (Guimaraes et al. 1994)."""

    id, family, parameter, unit = (
        "activation_dependent_fiber_length",
        "muscle",
        "relative_length_at_rest",
        "1",
    )
    limits = (0.02, 0.30)

    def force(self, force: np.ndarray, a: np.ndarray, c: Constants, view: View) -> np.ndarray:
        length, v, cosine = fiber(view.lmt, c)
        stretch = 1 + self.size * np.exp(-a / 0.35)
        change = active(length / stretch, c.curves) - active(length, c.curves)
        return force + c.fmax * a * cosine * change * velocity(v, c.curves)


class ForceEnhancement(Effect):
    """Active stretch leaves a force that levels off with stretch and fades (Herzog and Leonard 2002)."""

    id, family, parameter, unit = "force_enhancement", "muscle", "relative_gain_at_saturation", "1"
    limits = (0.05, 0.9)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.tau = float(rng.uniform(0.15, 0.5))
        self.extra = {"time_constant_s": self.tau}

    def force(self, force: np.ndarray, a: np.ndarray, c: Constants, view: View) -> np.ndarray:
        length, v, cosine = fiber(view.lmt, c)
        stretch = np.maximum(v, 0.0) * c.vmax * np.minimum(a / 0.1, 1.0)
        memory = np.zeros_like(a)
        for t in range(1, len(a)):
            memory[t] = memory[t - 1] * (1 - 1 / (RATE * self.tau)) + stretch[t] / RATE
        gain = self.size * np.tanh(memory / 0.10)
        return force + c.fmax * cosine * a * active(length, c.curves) * velocity(v, c.curves) * gain


class ForceSharing(Effect):
    """Part of the gastrocnemius force reaches the heel through the soleus fascia and so bypasses the knee."""

    id, family, parameter, unit = "force_sharing", "muscle", "share_at_peak_force", "1"
    limits = (0.03, 0.5)

    def moment(self, force: np.ndarray, view: View) -> np.ndarray:
        out = np.zeros((len(force), 6))
        for name in ("med_gas", "lat_gas"):
            i = view.index(name)
            peak = 0.4 * view.muscles.fmax[i]
            share = self.size * force[:, i] / (peak + force[:, i])
            out[:, 3] -= share * force[:, i] * view.arms[:, i, 3] * view.person.leg.knee_sign
            out[:, 4] += 0.15 * share * force[:, i] * view.arms[:, i, 4]
        return out


class Contracture(Effect):
    """Collagen in parallel with the fibers: a one-sided spring that starts inside the walking range."""

    id, family, parameter, unit = "contracture", "passive", "force_at_longest_gait_length", "fmax"
    limits = (0.02, 0.6)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.group, self.rows = pick(rng, ("plantarflexors", "hamstrings", "hip_flexors"))
        self.onset = float(rng.uniform(0.3, 0.6))
        self.extra = {"group": self.group, "onset_in_range": self.onset}

    def force(self, force: np.ndarray, a: np.ndarray, c: Constants, view: View) -> np.ndarray:
        out = force.copy()
        for i in self.rows:
            x, usual = view.lmt[:, i], view.habit.lmt[:, i]
            z = (x - np.percentile(usual, 1)) / (np.percentile(usual, 99) - np.percentile(usual, 1))
            ramp = np.logaddexp(0.0, 12 * (z - self.onset)) / 12 / (1 - self.onset)
            out[:, i] += self.size * c.fmax[i] * ramp**1.5
        return out


class Titin(Effect):
    """Outside the catalogue: a spring whose stiffness rises with activation (titin binding to actin)."""

    id, family, parameter, unit = (
        "outside_titin",
        "muscle",
        "stiffness_at_full_activation",
        "fmax per optimal length",
    )
    limits = (0.3, 12.0)

    def force(self, force: np.ndarray, a: np.ndarray, c: Constants, view: View) -> np.ndarray:
        length, _, cosine = fiber(view.lmt, c)
        return force + c.fmax * cosine * self.size * a * np.maximum(length - 0.75, 0) ** 2


class TendonCreep(Effect):
    """Outside the catalogue: slack lengths of the plantarflexors grow with loading through each recording."""

    id, family, parameter, unit = "outside_tendon_creep", "tendon", "strain_at_end", "1"
    limits = (0.002, 0.04)

    def force(self, force: np.ndarray, a: np.ndarray, c: Constants, view: View) -> np.ndarray:
        out = force.copy()
        part = np.clip(view.rec.phase / (len(view.rec.events) - 1), 0, 1.1)
        rows = [view.index(n) for n in PLANTAR]
        longer = view.lmt.copy()
        longer[:, rows] -= c.ls[rows] * (self.size * np.log1p(4 * part) / np.log(5))[:, None]
        length, v, cosine = fiber(longer, c)
        total = (
            c.fmax
            * cosine
            * (a * active(length, c.curves) * velocity(v, c.curves) + passive(length, c.curves))
        )
        out[:, rows] = total[:, rows]
        return out


class LooseRetinaculum(Effect):
    """Outside the catalogue: under force, tibialis anterior and long extensor bow away from the ankle."""

    id, family, parameter, unit = "outside_tendon_bowing", "geometry", "arm_gain_at_fmax", "1"
    limits = (0.1, 2.5)

    def moment(self, force: np.ndarray, view: View) -> np.ndarray:
        out = np.zeros((len(force), 6))
        for name in ("tib_ant", "ext_dig", "soleus", "med_gas"):
            i = view.index(name)
            load = np.sqrt(force[:, i] / view.muscles.fmax[i])
            out[:, 4] += (
                self.size
                * load
                * force[:, i]
                * view.arms[:, i, 4]
                * (0.5 if i > view.index("flex_hal") else 0.25)
            )
        return out
