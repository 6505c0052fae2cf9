"""Causes in joints, devices and geometry."""

from __future__ import annotations

import numpy as np

from . import anatomy
from .effect import Effect, View
from .leg import Leg, rotation
from .person import Person


class PassiveMoment(Effect):
    """Capsule and ligaments: a stiffening spring towards one end of range, shifted by a neighbour."""

    id, family, parameter, unit = "passive_joint_moment", "passive", "moment_at_end_of_range", "Nm/kg"
    limits = (0.015, 0.30)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.joint, self.end, self.other = ((0, -1, 3), (3, 1, 0), (4, 1, 3), (4, -1, 3), (1, 1, 0))[
            int(rng.integers(5))
        ]
        self.onset, self.couple = float(rng.uniform(0.4, 0.65)), float(rng.uniform(-0.25, 0.25))
        self.extra = {"coordinate": anatomy.COORDS[self.joint], "end": "high" if self.end > 0 else "low",
                      "onset_in_range": self.onset, "neighbour_shift": self.couple}  # fmt: skip

    def moment(self, force: np.ndarray, view: View) -> np.ndarray:
        q, habit = view.flexion, view.habit.flexion

        def unit(k: int) -> np.ndarray:
            low, high = np.percentile(habit[:, k], [1, 99])
            return (q[:, k] - low) / (high - low)

        z = unit(self.joint) if self.end > 0 else 1 - unit(self.joint)
        z = z + self.couple * (unit(self.other) - 0.5)
        ramp = np.logaddexp(0, 15 * (z - self.onset)) / 15 / (1 - self.onset)
        out = np.zeros_like(q)
        out[:, self.joint] = -self.end * self.size * view.person.mass * ramp**2
        return out


class JointDamping(Effect):
    """Synovial and soft-tissue damping that thins with speed (power 0.8 of joint velocity)."""

    id, family, parameter, unit = "joint_damping", "passive", "coefficient_at_1_rad_per_s", "Nms/rad/kg"
    limits = (0.002, 0.08)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.joint = int(rng.choice([0, 3, 4]))
        self.extra = {"coordinate": anatomy.COORDS[self.joint]}

    def moment(self, force: np.ndarray, view: View) -> np.ndarray:
        v = view.rate
        out = np.zeros_like(v)
        x = v[:, self.joint]
        out[:, self.joint] = -self.size * view.person.mass * x / (x**2 + 0.05) ** 0.1
        return out


class BiarticularSpring(Effect):
    """A strap of fascia across hip and knee that only pulls: quadratic beyond its slack length."""

    id, family, parameter, unit = "biarticular_spring", "passive", "tension_at_longest", "N/kg"
    limits = (0.2, 6.0)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.front = bool(rng.integers(2))
        self.arms = np.array([0.045, 0.038]) * rng.uniform(0.8, 1.2, 2)
        self.extra = {"side": "front" if self.front else "back", "arms_m": [float(a) for a in self.arms]}

    def moment(self, force: np.ndarray, view: View) -> np.ndarray:
        q, habit = view.flexion, view.habit.flexion
        # In front: longer with hip extension and knee flexion; behind: the reverse.
        pull = np.array([1.0, -1.0]) * self.arms * (1 if self.front else -1)
        x, usual = (-(pull[0] * one[:, 0] + pull[1] * one[:, 3]) for one in (q, habit))
        low, high = np.percentile(usual, 35), np.percentile(usual, 99.5)
        tension = self.size * view.person.mass * (np.maximum(x - low, 0) / (high - low)) ** 2
        out = np.zeros_like(q)
        out[:, 0], out[:, 3] = tension * pull[0], tension * pull[1]
        return out


class AnkleOrthosis(Effect):
    """An orthosis or stiff shoe: two stiffnesses about its neutral angle, joined smoothly."""

    id, family, parameter, unit = "ankle_foot_orthosis", "device", "dorsiflexion_stiffness", "Nm/deg"
    limits = (0.05, 4.0)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.ratio, self.neutral = float(rng.uniform(0.2, 0.7)), float(rng.uniform(-4, 3))
        self.extra = {"plantarflexion_ratio": self.ratio, "neutral_deg": self.neutral}

    def moment(self, force: np.ndarray, view: View) -> np.ndarray:
        x = np.degrees(view.flexion[:, 4]) - self.neutral
        up = 0.5 * (x + np.sqrt(x**2 + 4))
        out = np.zeros((len(x), 6))
        out[:, 4] = -self.size * (up + self.ratio * (x - up))
        return out


class DeviceTorque(Effect):
    """An exoskeleton pushes once each cycle: fast rise, slower fall, scaled by body mass."""

    id, family, parameter, unit = "device_torque", "device", "peak_torque", "Nm/kg"
    limits, signs = (0.02, 0.5), (-1, 1)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.joint, peak = ((4, (0.45, 0.55)), (0, (0.6, 0.75)), (0, (0.1, 0.2)), (3, (0.10, 0.2)))[
            int(rng.integers(4))
        ]
        self.peak = float(rng.uniform(*peak))
        self.extra = {"coordinate": anatomy.COORDS[self.joint], "peak_cycle": self.peak}

    def moment(self, force: np.ndarray, view: View) -> np.ndarray:
        gap = np.mod(view.rec.phase - self.peak + 0.5, 1) - 0.5
        width = np.where(gap < 0, 0.16, 0.10)
        s = np.clip(1 - np.abs(gap) / width, 0, 1)
        out = np.zeros((len(gap), 6))
        direction = -1.0 if self.joint == 4 else 1.0
        out[:, self.joint] = direction * self.size * view.person.mass * s**3 * (10 - 15 * s + 6 * s**2)
        return out


class KneeLaxity(Effect):
    """Varus thrust: under load the knee gives way sideways, and a frontal spring moment acts at the hip."""

    id, family, parameter, unit = "knee_laxity", "passive", "lateral_shift_at_body_weight", "m"
    limits = (0.001, 0.02)

    def moment(self, force: np.ndarray, view: View) -> np.ndarray:
        load = view.rec.force[:, 1]
        part = np.tanh(load / (0.6 * view.person.mass * 9.81))
        out = np.zeros((len(load), 6))
        out[:, 1] = self.size * part * load
        return out


class WrapRadius(Effect):
    """A true muscle bed is larger or smaller than that of the generic model."""

    id, family, parameter, unit = "wrap_surface", "geometry", "relative_radius", "1"
    limits, signs = (0.05, 0.5), (-1, 1)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.name = str(rng.choice(["knee_front", "hip_front", "knee_back", "ankle_front"]))
        if self.name == "knee_back":
            # The origin of the gastrocnemii must stay outside the cylinder.
            self.size = min(self.size, 0.12)
        self.extra = {"cylinder": self.name}

    def true_leg(self, leg: Leg) -> Leg:
        out = leg.copy()
        out.cylinders[self.name].radius *= 1 + self.size
        return out


class Attachment(Effect):
    """The attachments of a muscle lie elsewhere in this person: its last point moves in a drawn direction."""

    id, family, parameter, unit = "muscle_attachment", "geometry", "distance", "m"
    limits = (0.004, 0.03)
    SITES = (
        "soleus",
        "med_gas",
        "semimem",
        "glut_med2",
        "rect_fem",
        "tib_ant",
        "glut_max2",
        "bifemlh",
        "vas_lat",
    )

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.name = str(rng.choice(self.SITES))
        first = self.name in ("semimem", "glut_med2", "glut_max2", "bifemlh")
        self.at = 0 if first else -1
        angle = rng.uniform(0, 2 * np.pi)
        # Mostly in the sagittal plane, where it changes the arms of the large moments.
        self.direction = np.array([np.cos(angle), np.sin(angle), 0.3 * rng.standard_normal()])
        self.direction /= np.linalg.norm(self.direction)
        self.extra = {"muscle": self.name, "point": "origin" if first else "insertion",
                      "direction": [float(x) for x in self.direction]}  # fmt: skip

    def true_leg(self, leg: Leg) -> Leg:
        out = leg.copy()
        bodies, points = out.paths[self.name]
        points = points.copy()
        points[self.at] += self.size * self.direction
        out.paths[self.name] = (bodies, points)
        return out


class AxisRotation(Effect):
    """The lab's joint axis is turned about the long axis (knee) or the vertical (ankle, subtalar joint)."""

    id, family, parameter, unit = "joint_axis_rotation", "motion", "angle", "deg"
    limits, signs = (2.0, 25.0), (-1, 1)

    def draw(self, rng: np.random.Generator, person: Person) -> None:
        self.joint = str(rng.choice(["knee", "ankle", "subtalar"]))
        self.about = np.array([0.0, 1.0, 0.0]) if rng.random() < 0.5 else np.array([1.0, 0.0, 0.0])
        self.extra = {"joint": self.joint, "about": [float(x) for x in self.about]}

    def lab_leg(self, leg: Leg) -> Leg:
        out = leg.copy()
        turn = rotation(self.about, np.array([np.radians(self.size)]))[0]
        out.axes[self.joint] = turn @ out.axes[self.joint]
        return out
