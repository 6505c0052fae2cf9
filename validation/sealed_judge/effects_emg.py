"""Causes in neural drive and electromyography."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from . import anatomy
from .effect import Effect, View
from .muscle import RATE, Constants, fiber
from .person import Person

STRONG = (
    "soleus",
    "gastrocnemius_medialis",
    "gluteus_medius",
    "medial_hamstrings",
    "iliopsoas",
    "tibialis_anterior",
)


def shift(values: np.ndarray, seconds: np.ndarray | float) -> np.ndarray:
    """Return columns evaluated ``seconds`` later on the time axis (linear interpolation, ends held)."""
    at = np.arange(len(values)) / RATE
    return np.stack([np.interp(at + seconds, at, col) for col in values.T], axis=1)


class MissingDrive(Effect):
    """A muscle without electrode is active: a raised-cosine burst each cycle, larger at higher speed."""

    id, family, parameter, unit = "missing_drive", "emg", "peak_drive", "1"
    limits = (0.05, 0.8)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        group = int(rng.integers(2))
        self.members = (("pect", "sartorius"), ("flex_hal",))[group]
        self.centre = float(rng.uniform(*((0.54, 0.66), (0.36, 0.50))[group]))
        self.width = float(rng.uniform(0.14, 0.22))
        self.extra = {
            "muscles": list(self.members),
            "centre_cycle": self.centre,
            "half_width_cycle": self.width,
        }

    def muscles(self, c: Constants, view: View) -> Constants:
        # The muscle is not slack in this person.
        ls = c.ls.copy()
        for name in self.members:
            i = view.index(name)
            ls[i] -= 0.12 * c.lo[i]
        return c.with_(ls=ls)

    def drive(self, drive: np.ndarray, view: View) -> np.ndarray:
        gap = np.mod(view.rec.phase - self.centre + 0.5, 1.0) - 0.5
        burst = np.where(np.abs(gap) < self.width, np.cos(0.5 * np.pi * gap / self.width) ** 2, 0.0)
        out = drive.copy()
        for name in self.members:
            out[:, view.index(name)] += self.size * burst * np.sqrt(view.rec.speed / max(view.speeds))
        return out


class SpeedDelay(Effect):
    """The electromechanical delay differs between speeds, in proportion to the logarithm of speed."""

    id, family, parameter, unit = "speed_dependent_delay", "emg", "delay_change_slow_to_fast", "s"
    limits, signs = (0.002, 0.060), (-1, 1)

    def drive(self, drive: np.ndarray, view: View) -> np.ndarray:
        low, high = np.log(min(view.speeds)), np.log(max(view.speeds))
        part = (np.log(view.rec.speed) - low) / (high - low) - 0.5
        return shift(drive, -self.size * part)


class EmgDrift(Effect):
    """The gain of some electrodes drifts in the order of recording and levels off (drying gel, sweat)."""

    id, family, parameter, unit = "emg_drift", "emg", "relative_change_at_end", "1"
    limits, signs = (0.08, 0.6), (-1, 1)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        first = int(rng.integers(len(STRONG)))
        others = rng.choice(len(anatomy.CHANNELS), int(rng.integers(0, 3)), replace=False)
        self.channels = sorted({anatomy.CHANNEL_NAMES.index(STRONG[first]), *map(int, others)})
        self.tau = float(rng.uniform(0.4, 1.2))
        self.extra = {
            "channels": [anatomy.CHANNEL_NAMES[i] for i in self.channels],
            "time_constant": self.tau,
        }

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        # Position in the session: recordings follow one another with equal weight.
        order = view.speeds.index(view.rec.speed)
        count = len(view.rec.events) - 1
        part = (order + np.clip(view.rec.phase / count, 0, 1)) / len(view.speeds)
        grow = (1 - np.exp(-part / self.tau)) / (1 - np.exp(-1 / self.tau))
        out = envelope.copy()
        out[:, self.channels] *= np.maximum(1 + self.size * grow, 0.05)[:, None]
        return out


class Crosstalk(Effect):
    """The signals of neighbours add in power, because their sources are uncorrelated."""

    id, family, parameter, unit = "emg_crosstalk", "emg", "amplitude_ratio", "1"
    limits = (0.05, 0.8)
    PAIRS = (
        ("tibialis_anterior", "peroneus"), ("tibialis_anterior", "soleus"),
        ("gastrocnemius_medialis", "tibialis_anterior"),
        ("rectus_femoris", "vastus_lateralis"), ("medial_hamstrings", "adductors"),
        ("biceps_femoris", "vastus_lateralis"),
        ("soleus", "gastrocnemius_medialis"), ("gluteus_maximus", "gluteus_medius"),
        ("vastus_medialis", "adductors"),
        ("vastus_lateralis", "rectus_femoris"), ("medial_hamstrings", "gastrocnemius_medialis"),
    )  # fmt: skip

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        chosen = rng.choice(len(self.PAIRS), 2, replace=False)
        self.pairs = [self.PAIRS[int(i)] for i in chosen]
        self.extra = {"onto_from": [list(p) for p in self.pairs]}

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        out = envelope.copy()
        for onto, source in self.pairs:
            i, j = anatomy.CHANNEL_NAMES.index(onto), anatomy.CHANNEL_NAMES.index(source)
            out[:, i] = np.hypot(out[:, i], self.size * envelope[:, j])
        return out


class EmgNonlinearity(Effect):
    """The amplitude saturates with drive by cancellation of potentials (Keenan et al. 2005): a hyperbola."""

    id, family, parameter, unit = "emg_nonlinearity", "emg", "half_saturation_inverse", "1"
    limits = (0.3, 12.0)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.lift = bool(rng.integers(2))
        self.extra = {"direction": "convex" if self.lift else "saturating"}

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        e = np.clip(envelope, 0, 1.4)
        if self.lift:
            return e / (1 + self.size * np.maximum(1 - e, 0)) + np.maximum(envelope - e, 0)
        return envelope * (1 + self.size) / (1 + self.size * envelope)


class PostureGain(Effect):
    """The muscle belly slides under its electrode; detection falls as a Gaussian of the shift."""

    id, family, parameter, unit = "posture_dependent_gain", "emg", "log_gain_range", "1"
    limits, signs = (0.1, 1.5), (-1, 1)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        chosen = {int(rng.integers(len(STRONG))), int(rng.integers(len(STRONG)))}
        self.channels = [STRONG[i] for i in sorted(chosen)]
        self.extra = {"channels": self.channels}

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        length, usual = (fiber(one.lmt, one.muscles)[0] for one in (view, view.habit))
        out = envelope.copy()
        for name in self.channels:
            row = view.index(anatomy.CHANNELS[name][0])
            low, width = usual[:, row].min(), np.ptp(usual[:, row])
            # Gaussian of width 1 in the range of walking, its centre beyond the long end.
            g, of_walking = (0.5 * ((x[:, row] - low) / width - 1.3) ** 2 for x in (length, usual))
            change = (g - of_walking.mean()) / np.ptp(of_walking)
            out[:, anatomy.CHANNEL_NAMES.index(name)] *= np.exp(-self.size * change)
        return out


class EmgFloor(Effect):
    """Electrode and amplifier noise adds in power to the signals and is not taken off."""

    id, family, parameter, unit = "emg_offset", "emg", "floor_relative_to_peak", "1"
    limits = (0.02, 0.30)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.channels = sorted(int(i) for i in rng.choice(len(anatomy.CHANNELS), 6, replace=False))
        self.extra = {"channels": [anatomy.CHANNEL_NAMES[i] for i in self.channels]}

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        out = envelope.copy()
        out[:, self.channels] = np.hypot(out[:, self.channels], self.size)
        return out


class HiddenSpasticity(Effect):
    """A stretch reflex that no electrode sees: square root of fiber velocity, delayed."""

    id, family, parameter, unit = "spasticity_unrecorded", "emg", "drive_at_peak_stretch", "1"
    limits = (0.03, 0.6)
    SITES = ("vas_int", "bifemsh", "semimem", "flex_hal", "lat_gas")

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.site = self.SITES[int(rng.integers(len(self.SITES)))]
        self.latency = float(rng.uniform(0.03, 0.05))
        self.extra = {"muscle": self.site, "latency_s": self.latency}

    def drive(self, drive: np.ndarray, view: View) -> np.ndarray:
        i = view.index(self.site)
        _, v, _ = fiber(view.lmt, view.muscles)
        over = np.maximum(v[:, i : i + 1] - 0.02, 0.0) / 0.3
        out = drive.copy()
        out[:, i] += self.size * shift(np.sqrt(over + 0.01) - 0.1, -self.latency)[:, 0]
        return out

    def muscles(self, c: Constants, view: View) -> Constants:
        if self.site not in anatomy.SILENT:
            return c
        ls = c.ls.copy()
        ls[view.index(self.site)] -= 0.12 * c.lo[view.index(self.site)]
        return c.with_(ls=ls)


class SlowRelaxation(Effect):
    """Activation falls more slowly than it rises: a first-order stage that acts on the falling side only."""

    id, family, parameter, unit = "deactivation_asymmetry", "muscle", "decay_time_constant", "s"
    limits = (0.003, 0.120)

    def activation(self, a: np.ndarray, view: View) -> np.ndarray:
        keep = np.exp(-1.0 / (RATE * self.size))
        out = a.copy()
        for t in range(1, len(a)):
            out[t] = np.maximum(a[t], a[t] + (out[t - 1] - a[t]) * keep)
        return out


class EventJitter(Effect):
    """The clock of the electromyograph slips by a random time in each cycle."""

    id, family, parameter, unit = "event_jitter", "emg", "sd_of_slip", "cycle"
    limits = (0.001, 0.08)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.slips = np.clip(rng.standard_normal((3, 20)), -1.8, 1.8)

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        order = view.speeds.index(view.rec.speed)
        knots = np.arange(-2, 18) + 0.5
        slip = PchipInterpolator(knots, self.slips[order])(view.rec.phase)
        period = np.diff(view.rec.events).mean()
        return shift(envelope, self.size * slip * period)


class SwappedElectrodes(Effect):
    """Outside the catalogue: a share of two leads is exchanged in part of the cycles (loose plugs)."""

    id, family, parameter, unit = "outside_swapped_leads", "emg", "share", "1"
    limits = (0.1, 1.0)
    PAIRS = (("soleus", "tibialis_anterior"), ("medial_hamstrings", "biceps_femoris"),
             ("vastus_lateralis", "rectus_femoris"),
             ("gastrocnemius_medialis", "tibialis_posterior"),
             ("gluteus_maximus", "gluteus_medius"))  # fmt: skip

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.pair = self.PAIRS[int(rng.integers(len(self.PAIRS)))]
        self.extra = {"channels": list(self.pair)}

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        i, j = (anatomy.CHANNEL_NAMES.index(n) for n in self.pair)
        out = envelope.copy()
        out[:, i] = (1 - self.size) * envelope[:, i] + self.size * envelope[:, j]
        out[:, j] = (1 - self.size) * envelope[:, j] + self.size * envelope[:, i]
        return out


class Dropouts(Effect):
    """Outside the catalogue: short losses of contact of one electrode after heel strike in random cycles."""

    id, family, parameter, unit = "outside_contact_loss", "emg", "relative_loss", "1"
    limits = (0.1, 1.0)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.channel = STRONG[int(rng.integers(len(STRONG)))]
        self.lost = rng.random((3, 20)) < 0.4
        self.start = float(rng.uniform(0, 1))
        self.extra = {"channel": self.channel, "start_cycle": self.start}

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        order = view.speeds.index(view.rec.speed)
        ph = view.rec.phase - self.start
        cycle = np.clip(np.floor(ph).astype(int) + 2, 0, 19)
        gone = self.lost[order][cycle] * np.clip(
            6 * np.sin(np.pi * np.clip(np.mod(ph, 1) / 0.35, 0, 1)), 0, 1
        )
        out = envelope.copy()
        out[:, anatomy.CHANNEL_NAMES.index(self.channel)] *= 1 - self.size * gone
        return out


class ClockDrift(Effect):
    """Outside the catalogue: the clock of the electromyograph runs fast or slow in each recording."""

    id, family, parameter, unit = "outside_clock_drift", "emg", "relative_rate_error", "1"
    limits, signs = (0.0003, 0.03), (-1, 1)

    def emg(self, envelope: np.ndarray, view: View) -> np.ndarray:
        return shift(envelope, self.size * (view.rec.time - view.rec.events[0]))


class Potentiation(Effect):
    """Outside the catalogue: force per activation grows after each burst and decays over about a second."""

    id, family, parameter, unit = "outside_potentiation", "muscle", "gain_at_full_memory", "1"
    limits, signs = (0.1, 2.0), (1,)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.tau = float(rng.uniform(0.15, 0.5))
        self.extra = {"time_constant_s": self.tau}

    def activation(self, a: np.ndarray, view: View) -> np.ndarray:
        memory, keep = np.zeros_like(a), np.exp(-1.0 / (RATE * self.tau))
        memory[0] = a[0]
        for t in range(1, len(a)):
            memory[t] = keep * memory[t - 1] + (1 - keep) * a[t]
        return a * (1 + self.size * (memory - memory.mean(axis=0)))
