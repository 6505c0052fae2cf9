"""Causes in measured motion and ground reaction."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from . import anatomy
from .effect import Effect, Measured, View
from .effects_emg import shift
from .gait import stance_fraction
from .leg import Leg, frames
from .muscle import RATE
from .person import Person


class CopOffset(Effect):
    """The plate's origin is misplaced along or across the walkway."""

    id, family, parameter, unit = "cop_offset", "force", "offset", "m"
    limits, signs = (0.003, 0.03), (-1, 1)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.axis = int(rng.choice([0, 0, 2]))
        self.extra = {"axis": "forward" if self.axis == 0 else "lateral"}

    def measure(self, m: Measured, view: View) -> None:
        m.cop[:, self.axis] += self.size


class HipCenter(Effect):
    """The lab's hip joint centre is off; the pelvis of its model follows so that the leg stays in place."""

    id, family, parameter, unit = "hip_center_offset", "motion", "distance", "m"
    limits = (0.004, 0.04)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        d = rng.standard_normal(3)
        d[int(rng.integers(3))] *= 3
        self.direction = d / np.linalg.norm(d)
        self.extra = {"direction": [float(x) for x in self.direction]}

    def lab_leg(self, leg: Leg) -> Leg:
        out = leg.copy()
        out.joints["hip"] = out.joints["hip"] + self.size * self.direction
        # Markers on the thigh hold the femur, so that the point of the femur at the wrong centre is another
        # one.
        for name, (bodies, points) in out.paths.items():
            points = points.copy()
            points[bodies == anatomy.FEMUR] -= self.size * self.direction
            out.paths[name] = (bodies, points)
        for cylinder in out.cylinders.values():
            if cylinder.body == anatomy.FEMUR:
                cylinder.centre = cylinder.centre - self.size * self.direction
        out.joints["knee"] = out.joints["knee"] - self.size * self.direction
        mass, com, inertia = out.segments["femur"]
        out.segments["femur"] = (mass, com - self.size * self.direction, inertia)
        return out


class ForceLatency(Effect):
    """Forces are late against motion, and smoothed by the same one-pole filter that delays them."""

    id, family, parameter, unit = "force_latency", "force", "latency", "s"
    limits, signs = (0.003, 0.030), (-1, 1)

    def measure(self, m: Measured, view: View) -> None:
        load = np.cross(m.cop, m.force)
        pole = np.exp(-1.0 / (RATE * 0.3 * abs(self.size)))

        def late(x: np.ndarray) -> np.ndarray:
            moved = shift(x, -0.7 * self.size)
            if self.size > 0:
                return lfilter([1 - pole], [1, -pole], moved, axis=0)
            return lfilter([1 - pole], [1, -pole], moved[::-1], axis=0)[::-1]

        both = late(np.column_stack([m.force, load, m.free]))
        m.force = both[:, :3]
        up = both[:, 1]
        loaded = up > 15
        x, z = both[:, 5] / np.maximum(up, 1), -both[:, 3] / np.maximum(up, 1)
        m.cop = np.where(loaded[:, None], np.stack([x, 0 * x, z], axis=1), m.cop)
        m.free = both[:, 6]


class SegmentInertia(Effect):
    """The lab's segment has the wrong mass; inertia and centre of mass go with it."""

    id, family, parameter, unit = "segment_inertia", "motion", "relative_mass_error", "1"
    limits, signs = (0.05, 0.60), (-1, 1)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.segments = (("tibia",), ("calcn",), ("tibia", "calcn"), ("femur",))[int(rng.integers(4))]
        self.extra = {"segments": list(self.segments)}

    def lab_leg(self, leg: Leg) -> Leg:
        out = leg.copy()
        for s in self.segments:
            mass, com, inertia = out.segments[s]
            out.segments[s] = (mass * (1 + self.size), com * (1 + 0.3 * self.size), inertia * (1 + self.size))
        return out


class SoftTissue(Effect):
    """Skin moves over bone: a share of flexion and a damped swing of the markers after heel strike."""

    id, family, parameter, unit = "soft_tissue_artifact", "motion", "peak_angle", "deg"
    limits, signs = (0.2, 10.0), (-1, 1)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.share = rng.standard_normal((2, 4)) * np.array([[1.0, 0.6, 1.2, 1.0], [0.5, 0.3, 0.5, 0.5]])
        self.share /= np.abs(self.share).max()
        self.extra = {"hip_flexion_share": float(self.share[0, 0]), "knee_share": float(self.share[0, 3])}

    def measure(self, m: Measured, view: View) -> None:
        bend = view.flexion[:, 3]
        bend = bend / bend.max()
        since = np.mod(view.rec.phase, 1.0) * np.diff(view.rec.events).mean()
        swing = np.exp(-since / 0.08) * np.sin(2 * np.pi * 5 * since)
        swing = sosfiltfilt(butter(2, 8.0, fs=RATE, output="sos"), swing)
        for j in range(4):
            error = np.radians(self.size) * (self.share[0, j] * bend**1.5 + self.share[1, j] * swing)
            m.q[:, j] += error * (view.person.leg.knee_sign if j == 3 else 1)


class FootDeformation(Effect):
    """The arch flattens under load and springs back with a lag: the measured ankle angle contains it."""

    id, family, parameter, unit = "foot_deformation", "motion", "angle_at_body_weight", "deg"
    limits, signs = (0.2, 10.0), (-1, 1)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.lag = float(rng.uniform(0.02, 0.06))
        self.extra = {"lag_s": self.lag}

    def measure(self, m: Measured, view: View) -> None:
        rot, org = frames(view.person.leg, view.rec.q, view.rec.pelvis)
        lever = np.einsum("ti,ti->t", rot[:, 4, :, 0], view.rec.cop - org[:, 4])
        load = view.rec.force[:, 1] / (view.person.mass * 9.81) * np.clip(lever / 0.15, 0, 1.3)
        pole = np.exp(-1 / (RATE * self.lag))
        bent = lfilter([1 - pole], [1, -pole], load)
        bent = sosfiltfilt(butter(2, 10.0, fs=RATE, output="sos"), bent)
        m.q[:, 4] += np.radians(self.size) * bent


class BeltAcceleration(Effect):
    """The belt slows at each foot contact; the inertia of belt and rollers enters the forward force."""

    id, family, parameter, unit = "belt_acceleration", "device", "peak_force", "N/kg"
    limits = (0.05, 0.8)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.height = float(rng.uniform(0.05, 0.15))
        self.extra = {"height_of_plate_inertia_m": self.height}

    def measure(self, m: Measured, view: View) -> None:
        part = np.mod(view.rec.phase, 1) / stance_fraction(view.rec.speed)
        s = np.clip(part, 0, 1)
        wave = np.sin(2 * np.pi * 1.5 * s) * np.exp(-2.0 * s) * (1 - s) ** 0.5 * (part < 1)
        push = self.size * view.person.mass * wave / 0.55
        loaded = m.force[:, 1] > 60
        m.force[:, 0] += push * loaded
        m.cop[:, 0] += np.where(
            loaded, np.clip(self.height * push / np.maximum(m.force[:, 1], 60), -0.06, 0.06), 0
        )


class CrossedPlates(Effect):
    """In double support part of the other foot's load is on this plate."""

    id, family, parameter, unit = "crossed_plates", "force", "share_of_other_foot", "1"
    limits = (0.004, 0.5)

    def measure(self, m: Measured, view: View) -> None:
        r = view.rec
        both = (r.force[:, 1] > 20) & (r.other_force[:, 1] > 20)
        taper = np.clip(np.minimum(r.force[:, 1], r.other_force[:, 1]) / 150, 0, 1) * both
        part = (self.size * taper)[:, None]
        total = m.force + part * r.other_force
        load = np.cross(m.cop, m.force) + part * np.cross(r.other_cop, r.other_force)
        up = np.maximum(total[:, 1], 20)
        mixed = np.stack([load[:, 2] / up, 0 * up, -load[:, 0] / up], axis=1)
        m.cop = np.where(both[:, None], mixed, m.cop)
        m.force = total


class WobblingMass(Effect):
    """Soft tissue of the thigh lags after impact: a damped oscillation in the moments of hip and knee."""

    id, family, parameter, unit = "wobbling_mass", "motion", "peak_moment", "Nm/kg"
    limits = (0.02, 0.35)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.freq, self.decay = float(rng.uniform(5, 9)), float(rng.uniform(0.06, 0.12))
        self.extra = {"frequency_hz": self.freq, "decay_s": self.decay}

    def report(self, moments: np.ndarray, view: View) -> np.ndarray:
        since = np.mod(view.rec.phase, 1.0) * np.diff(view.rec.events).mean()
        wave = np.exp(-since / self.decay) * np.sin(2 * np.pi * self.freq * since)
        wave = self.size * view.person.mass * view.rec.speed / max(view.speeds) * wave
        out = moments.copy()
        out[:, 0] += wave
        out[:, 3] -= 0.4 * wave * view.person.leg.knee_sign
        out[:, 4] += 0.15 * wave
        return out


class PlateHeight(Effect):
    """Outside the catalogue: the walking surface lies above the plane in which the plate gives its centre."""

    id, family, parameter, unit = "outside_plate_height", "force", "height", "m"
    limits, signs = (0.005, 0.08), (-1, 1)

    def measure(self, m: Measured, view: View) -> None:
        up = np.maximum(m.force[:, 1], 30)
        m.cop[:, 0] += np.clip(self.size * m.force[:, 0] / up, -0.05, 0.05)
        m.cop[:, 2] += np.clip(self.size * m.force[:, 2] / up, -0.05, 0.05)


class PlateGain(Effect):
    """Outside the catalogue: the plate's vertical channel reads low at high load (compressed range)."""

    id, family, parameter, unit = "outside_plate_compression", "force", "relative_loss_at_body_weight", "1"
    limits, signs = (0.02, 0.3), (-1, 1)

    def measure(self, m: Measured, view: View) -> None:
        part = np.maximum(m.force[:, 1], 0) / (view.person.mass * 9.81)
        m.force[:, 1] *= 1 - self.size * part**2


class OverSmoothing(Effect):
    """Outside the catalogue: joint angles were low-passed far too strongly."""

    id, family, parameter, unit = "outside_oversmoothed_angles", "motion", "smoothing_time", "s"
    limits = (0.015, 0.08)

    def measure(self, m: Measured, view: View) -> None:
        sos = butter(2, 0.25 / self.size, fs=RATE, output="sos")
        m.q = sosfiltfilt(sos, m.q, axis=0)
