"""By how much each wrong input of inverse dynamics changes the moments, for one unit of its amounts.

One function an effect of `wrapjax.diagnosis.effects.measurement.CHAIN`, in the order of its parameters. An
amount is by how much a laboratory's input was off, and its slope what that added to the moments that were
measured. Directions are those of a person: forward, up, and outward, away from the midline. Joints that a
subject lacks stay out of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.effects.kinematics import dragged_by, sliding
from wrapjax.diagnosis.inverse_dynamics.recorded_walk import CONTACT, Walk

Slopes = Float[np.ndarray, "parameter coordinate pose"]

#: The amounts of `joint_axis_rotation`: whose axis is turned, and about which one of the body that carries it
#: (forward, up, to the right).
TURNS = (
    ("knee_angle", 1),
    ("knee_angle", 0),
    ("ankle_angle", 1),
    ("ankle_angle", 0),
    ("subtalar_angle", 1),
    ("subtalar_angle", 2),
)
#: What else a joint in a wrong place does, by what the laboratory's kinematics went by: markers or angles.
FOOT_HELD, FOOT_DISPLACED = "foot in place", "foot displaced"
#: Share of the largest moment on the forefoot about which it sets in.
_ONSET = 0.05
#: Share of the cycle that soft tissue takes to come to rest.
_IMPACT = 0.1


def _cop_offset(walk: Walk) -> Slopes:
    """Forces act further forward, or outward, than they do."""
    return np.stack([_moved_forces(walk, walk.forward), _moved_forces(walk, walk.outward * walk.rightward)])


def _moved_forces(walk: Walk, direction: Float[np.ndarray, "3 pose"]) -> Float[np.ndarray, "coordinate pose"]:
    change = np.zeros_like(walk.wrench)
    change[:, :3] = np.cross(direction[None], walk.wrench[:, 3:], axis=1)
    return walk.moments_by_load(change)


def _force_latency(walk: Walk) -> Slopes:
    return walk.moments_by_load(walk.by_latency)[None]


def _crossed_plates(walk: Walk) -> Slopes:
    """While both feet are on the ground, plates give a share of a foot's force to the wrong one.

    Of the other foot's force, where it acts or at this foot's center of pressure; and of this foot's own,
    which is what stands on the other plate.
    """
    other, own = walk.other_foot(), walk.wrench.sum(axis=0)
    vertical = other[4]
    both = walk.in_contact & (vertical > CONTACT * vertical.max())
    point = walk.center_of_pressure
    leaked = np.concatenate([np.cross(point, other[3:], axis=0), other[3:]])
    slopes = []
    for crossed in (other, leaked, own):
        change = np.zeros_like(walk.wrench)
        change[0] = np.where(both, crossed, 0.0)
        slopes.append(walk.moments_by_load(change))
    return np.stack(slopes)


def _segment_inertia(walk: Walk) -> Slopes:
    """The model's mass of a segment, or its inertia about the center of mass, is too small.

    An amount is the person's, as what is reported: by what fraction of the model's theirs is larger.
    """
    return -np.stack(
        [
            walk.mechanics.moments(
                np.einsum("kb,bwp->kwp", walk.mechanics.moves[:, segment], needed[segment])
            )
            for segment in _segments(walk)
            for needed in (walk.mechanics.of_mass, walk.mechanics.of_inertia)
        ]
    )


def _segments(walk: Walk) -> tuple[list[int], list[int], list[int]]:
    """Number the bodies of thigh, shank and foot, told apart by their joints; a patella is in none."""
    mechanics = walk.mechanics

    def first_moved(stem: str) -> list[int]:
        """Number the body at the near end of what a coordinate moves."""
        rows = walk.starting(stem)
        moved: list[int] = np.flatnonzero(mechanics.moves[rows[0]]).tolist() if rows else []
        names = [mechanics.bodies[body] for body in moved]
        return [body for body in moved if mechanics.parents[body] not in names]

    thigh, shank = first_moved("hip_"), first_moved("knee_")
    ankle = walk.starting("ankle_")
    foot = np.flatnonzero(mechanics.moves[ankle[0]]).tolist() if ankle else []
    return thigh, shank, foot


def _hip_center_offset(walk: Walk) -> dict[str, Slopes]:
    """The hip's moment is taken about a center that is further forward, up or outward in the pelvis.

    Where markers hold the foot, nothing else is off. Where angles count for more than markers do, the model's
    leg hangs on its hip, and the ground's force acts elsewhere on all of it.
    """
    outward = np.diag([1.0, 1.0, walk.outward])
    axes = np.einsum("ijp,nj->nip", walk.mechanics.rotation[walk.pelvis], outward)
    force, rows = walk.transmitted()[:, 3:], walk.starting("hip_")
    held = np.zeros((3, *walk.mechanics.screw.shape[::2]))
    hung = np.zeros_like(held)
    for number, direction in enumerate(axes):
        for row in rows:
            lever = np.cross(direction, force[row], axis=0)
            held[number, row] = -(walk.mechanics.screw[row, :3] * lever).sum(axis=0)
        if rows:
            name = walk.mechanics.coordinates[rows[0]]
            hung[number] = walk.moments_by_joint(name, outward[number], np.zeros(3))
    return {FOOT_HELD: held, FOOT_DISPLACED: hung}


def _joint_axis_rotation(walk: Walk) -> dict[str, Slopes]:
    """The joint's whole moment is projected on an axis that is off, by either of the angles that place it.

    It is turned as toes are when they turn out, and about what is across: knee and ankle, whose axes go from
    side to side, about the direction that is forward, and the subtalar joint, whose goes forward, about the
    one that is outward. Where markers do not hold the foot, a bent joint also puts it elsewhere.
    """
    mechanics, wrench = walk.mechanics, walk.transmitted()
    held = np.zeros((6, *mechanics.screw.shape[::2]))
    hung = np.zeros_like(held)
    for number, (stem, column) in enumerate(TURNS):
        sign = turn_sign(column, walk.outward)
        for row in walk.starting(stem):
            moment = wrench[row, :3] - np.cross(mechanics.joint_center[row], wrench[row, 3:], axis=0)
            about = sign * mechanics.rotation[_carrier(walk, row), :, column]
            turned = np.cross(about, mechanics.screw[row, :3], axis=0)
            held[number, row] = (turned * moment).sum(axis=0)
            name = mechanics.coordinates[row]
            hung[number] += walk.moments_by_joint(name, np.zeros(3), sign * np.eye(3)[column])
    return {FOOT_HELD: held, FOOT_DISPLACED: hung}


def turn_sign(column: int, outward: float) -> float:
    """Say which way round a positive amount turns a joint's axis about an axis of the body that carries it.

    Parameters
    ----------
    column
        Of the carrier's axes: forward, up, to the right.
    outward
        1 on the right leg, -1 on the left.
    """
    # Of a right leg, outward is clockwise seen from above, and an axis' outer end goes up counterclockwise
    # seen from behind; its front end always goes up about what points to the right.
    return 1.0 if column == 2 else -outward


def _carrier(walk: Walk, coordinate: int) -> int:
    """Number the body that carries a coordinate's joint; its own child body where that is ground."""
    mechanics = walk.mechanics
    moved = np.flatnonzero(mechanics.moves[coordinate])
    names = [mechanics.bodies[body] for body in moved]
    child = next(body for body in moved if mechanics.parents[body] not in names)
    parent = mechanics.parents[child]
    return mechanics.bodies.index(parent) if parent in mechanics.bodies else int(child)


def foot_loads(walk: Walk) -> dict[str, Float[np.ndarray, "trial frame"]]:
    """Give what bends a foot, 1 where it is largest: the vertical force, and what it bends the forefoot by.

    Without an ankle, nothing does.
    """
    rows = walk.starting("ankle_angle")
    if not rows:
        return {}
    moment, force = walk.wrench.sum(axis=0).reshape(2, 3, -1)
    at_ankle = moment - np.cross(walk.mechanics.joint_center[rows[0]], force, axis=0)
    upward = (at_ankle * walk.rightward).sum(axis=0)
    # A load that set in at once would ask for accelerations that no foot has.
    onset = _ONSET * np.abs(upward).max()
    loads = {"whole foot": force[1], "forefoot": 0.5 * (upward + np.hypot(upward, onset))}
    return {
        where: (load / load.max()).reshape(walk.time.shape)
        for where, load in loads.items()
        if load.max() > 0.0
    }


def _foot_deformation(walk: Walk) -> dict[str, Slopes]:
    """The ankle was recorded too far in dorsiflexion, by an angle that goes with the foot's load."""
    slopes = {}
    for where, load in foot_loads(walk).items():
        errors = np.zeros((1, len(walk.mechanics.coordinates), *walk.time.shape))
        errors[0, walk.starting("ankle_angle")] = load
        slopes[where] = walk.moments_by_angles(errors)
    return slopes


def _soft_tissue_artifact(walk: Walk) -> dict[str, Slopes]:
    """Skin slid over bone, and angles were recorded that the bones did not have."""
    count, (trials, frames) = len(walk.mechanics.coordinates), walk.time.shape
    own, rows = walk.moving
    angles = np.zeros((count, trials, frames))
    angles[own] = walk.motion.values[rows].reshape(-1, trials, frames)
    apart = np.eye(count)[:, :, None, None]
    shares = [walk.moments_by_angles(apart * angles)]
    if neighbours := dragged_by(walk.mechanics.coordinates):
        shares.append(walk.moments_by_angles(apart * angles[list(neighbours)]))
    slides = {
        when: walk.moments_by_angles(np.broadcast_to(apart * shape, (count, count, trials, frames)))
        for when, (shape, _) in sliding(np.linspace(0.0, 1.0, frames)).items()
    }
    return {when: np.concatenate([own, *shares]) for when, own in slides.items()}


def _wobbling_mass(walk: Walk) -> dict[str, Slopes]:
    """Soft tissue gives way about hip flexion, or about the knee: at impact, or whenever the load changes.

    An amount is what that comes to over time while the foot is being loaded.
    """
    on_ground = walk.in_contact.reshape(walk.time.shape)
    struck = on_ground & ~np.roll(on_ground, 1, axis=1)
    # A cycle starts with the strike unless the forces say otherwise.
    start = np.where(struck.any(axis=1), struck.argmax(axis=1), 0)
    duration = walk.time[:, -1] - walk.time[:, 0]
    since = np.mod(walk.time - walk.time[np.arange(start.size), start][:, None], duration[:, None])
    length = _IMPACT * duration[:, None]
    pulse = np.where(since < length, 2.0 / length * np.sin(np.pi * since / length) ** 2, 0.0)
    vertical = walk.force[1].reshape(walk.time.shape)
    rate = np.gradient(vertical, axis=-1) / (walk.time[:, 1] - walk.time[:, 0])[:, None]
    shapes = {"impact": pulse, "every change of load": rate / vertical.max(axis=1, keepdims=True)}
    return {when: _about_hip_and_knee(walk, shape) for when, shape in shapes.items()}


def _about_hip_and_knee(walk: Walk, moment: Float[np.ndarray, "trial frame"]) -> Slopes:
    slopes = np.zeros((2, *walk.mechanics.screw.shape[::2]))
    for number, stem in enumerate(("hip_flexion", "knee_angle")):
        slopes[number, walk.starting(stem)] = moment.ravel()
    return slopes


def _knee_laxity(walk: Walk) -> Slopes:
    """The vertical force acts further outward, as seen from hip adduction and knee adduction."""
    vertical = np.zeros_like(walk.wrench)
    vertical[:, 4] = walk.wrench[:, 4]
    change = np.zeros_like(walk.wrench)
    outward = walk.outward * walk.rightward
    change[:, :3] = np.cross(outward[None], vertical[:, 3:], axis=1)
    slopes = np.zeros((1, *walk.mechanics.screw.shape[::2]))
    rows = walk.starting("hip_adduction") + walk.starting("knee_adduction")
    slopes[0, rows] = walk.moments_by_load(change)[rows]
    return slopes


#: From the id of an effect to what one unit of each of its amounts adds to the moments, by its shapes.
BY_SHAPE: dict[str, Callable[[Walk], dict[str, Slopes]]] = {
    "hip_center_offset": _hip_center_offset,
    "joint_axis_rotation": _joint_axis_rotation,
    "foot_deformation": _foot_deformation,
    "wobbling_mass": _wobbling_mass,
    "soft_tissue_artifact": _soft_tissue_artifact,
}
#: The same of effects with one shape.
SLOPES: dict[str, Callable[[Walk], Slopes]] = {
    "cop_offset": _cop_offset,
    "force_latency": _force_latency,
    "segment_inertia": _segment_inertia,
    "crossed_plates": _crossed_plates,
    "knee_laxity": _knee_laxity,
}
