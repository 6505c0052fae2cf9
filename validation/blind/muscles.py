"""Muscle parameters of a person, and muscle forces with rigid or compliant tendons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from validation.blind.families import Curves

#: Maximum fiber velocity, optimal fiber lengths per second.
MAX_VELOCITY = 10.0
#: Damping of fibers with a compliant tendon: share of the maximum force at maximum velocity.
DAMPING = 0.1


@dataclass(frozen=True)
class Muscles:
    """True muscle parameters, (muscle,) unless stated. The last six are neutral without an effect."""

    max_isometric_force: np.ndarray
    optimal_fiber_length: np.ndarray
    tendon_slack_length: np.ndarray
    pennation: np.ndarray
    scale: np.ndarray  # excitation for a full envelope
    delay: np.ndarray  # (recording, muscle), s
    rise: np.ndarray  # activation time, s
    fall: np.ndarray  # ratio of deactivation to activation time
    bend: np.ndarray  # activation nonlinearity, 0 to 1
    slowness: np.ndarray  # 0; relative reduction of the maximum velocity
    length_gain: np.ndarray  # 0; relative increase of the optimal fiber length at rest
    enhancement: np.ndarray  # 0; gain of force enhancement after stretch
    tightness: np.ndarray  # 0; relative shortening of passive fibers
    strain: np.ndarray  # 0; tendon strain at maximum force
    recruitment: np.ndarray  # 0; relative reduction of velocity at low activation


def muscle_forces(
    curves: Curves,
    muscles: Muscles,
    activation: np.ndarray,
    length: np.ndarray,
    rate: np.ndarray,
    step: float,
) -> np.ndarray:
    """Compute tendon forces (N) from activation, path length (m) and rate; (recording, muscle, frame)."""
    law = _Law(curves, muscles, activation, step)
    projection = law.column(np.cos(muscles.pennation))
    slack, reach = law.column(muscles.tendon_slack_length), law.reach
    fiber = (length - slack) / reach
    velocity = rate / reach
    if muscles.strain.any():
        stretched = muscles.strain > 0.0
        fiber[:, stretched], velocity[:, stretched] = _compliant_tendon_fibers(
            curves, muscles, activation, length, reach, step, stretched
        )
        damping = law.column(_damping(muscles.strain)) * velocity / MAX_VELOCITY
    else:
        damping = 0.0
    force = law.active(fiber, velocity) + law.passive(fiber) + damping
    return law.column(muscles.max_isometric_force) * projection * force


@dataclass(frozen=True)
class _Law:
    curves: Curves
    muscles: Muscles
    activation: np.ndarray
    step: float

    @staticmethod
    def column(values: np.ndarray) -> np.ndarray:
        return values[None, :, None]

    @property
    def reach(self) -> np.ndarray:
        return self.column(self.muscles.optimal_fiber_length * np.cos(self.muscles.pennation))

    def active(self, fiber: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        m, a = self.muscles, self.activation
        length = fiber
        if m.length_gain.any():
            # Longer at low activation: an exponential that is 0 at full activation.
            weak = (np.exp(-a / 0.4) - np.exp(-1.0 / 0.4)) / (1.0 - np.exp(-1.0 / 0.4))
            length = fiber / (1.0 + self.column(m.length_gain) * weak)
        slower = 1.0 - self.column(m.slowness)
        if m.recruitment.any():
            slower = slower * (1.0 - self.column(m.recruitment) * (1.0 - a) ** 2)
        normalized = velocity / (MAX_VELOCITY * slower)
        # The shortening curve of slow fibers is also more curved.
        deeper = 1.0 + 0.3 * self.column(m.slowness) * (1.0 + np.clip(normalized, -1.0, 0.0))
        normalized = np.where(velocity < 0.0, normalized * deeper, normalized)
        force = a * self.curves.active(length) * self.curves.velocity(normalized)
        return force * self.history(velocity) if m.enhancement.any() else force

    def passive(self, fiber: np.ndarray) -> np.ndarray:
        tight = self.column(self.muscles.tightness)
        return (1.0 + 2.0 * tight) * self.curves.passive(fiber / (1.0 - tight))

    def history(self, velocity: np.ndarray) -> np.ndarray:
        """Compute the force ratio after active stretch (saturating), with half as much lost by shortening."""
        gained = self._leaky(self.activation * np.maximum(velocity, 0.0), 0.35)
        lost = self._leaky(self.activation * np.maximum(-velocity, 0.0), 0.25)
        return 1.0 + self.column(self.muscles.enhancement) * (
            np.tanh(gained / 0.08) - 0.5 * np.tanh(lost / 0.08)
        )

    def _leaky(self, inflow: np.ndarray, time_constant: float) -> np.ndarray:
        keep = np.exp(-self.step / time_constant)
        return lfilter([self.step], [1.0, -keep], inflow, axis=-1)


def _damping(strain: np.ndarray) -> np.ndarray:
    # No damping for a rigid tendon: there it would change the muscle without effect.
    return DAMPING * np.tanh(strain / 0.03)


def tendon_force(stretch: np.ndarray, strain: np.ndarray) -> np.ndarray:
    """Compute normalized tendon force (Thelen 2003); ``strain`` is that at the maximum force."""
    toe_strain, toe_force = 0.609 * strain, 1.0 / 3.0
    slope = 1.712 / strain
    toe = toe_force * np.expm1(3.0 * np.clip(stretch / toe_strain, -1.0, 1.0)) / np.expm1(3.0)
    return toe + slope * np.maximum(stretch - toe_strain, 0.0)


def _compliant_tendon_fibers(curves, muscles, activation, length, reach, step, chosen):
    """Integrate fiber length and velocity with compliant tendons by implicit secant steps."""
    a, path = activation[:, chosen], length[:, chosen]
    reach = reach[:, chosen, 0]
    slack = muscles.tendon_slack_length[None, chosen]
    strain = muscles.strain[None, chosen]
    damping = _damping(strain)
    vmax = MAX_VELOCITY * step

    def unbalance(fiber, before, frame):
        moved = (fiber - before) / vmax
        pull = a[..., frame] * curves.active(fiber) * curves.velocity(np.clip(moved, -1.0, 1.0))
        pull = pull + curves.passive(fiber) + damping * moved
        return pull - tendon_force((path[..., frame] - fiber * reach) / slack - 1.0, strain)

    fibers = np.empty_like(path)
    now = (path[..., 0] - slack) / reach
    # The first frame has no velocity; solve it by bisection.
    low, high = now - 0.6, now + 0.05
    for _ in range(40):
        middle = 0.5 * (low + high)
        balance = unbalance(middle, middle, 0)
        low, high = np.where(balance < 0.0, middle, low), np.where(balance < 0.0, high, middle)
    now = middle
    fibers[..., 0] = now
    before = now
    for frame in range(1, path.shape[-1]):
        left = 2.0 * now - before
        before = now
        right = left + 2e-4
        g_left = unbalance(left, before, frame)
        for _ in range(4):
            g_right = unbalance(right, before, frame)
            slope = (g_right - g_left) / np.where(right == left, 1.0, right - left)
            newton = right - g_right / np.maximum(slope, 1.0)
            left, g_left = right, g_right
            right = np.where(np.abs(newton - right) < 1e-12, right, newton)
        now = right
        fibers[..., frame] = now
    return fibers, np.gradient(fibers, step, axis=-1)
