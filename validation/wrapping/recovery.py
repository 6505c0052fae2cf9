"""Recovery of displaced wrap surfaces from moment arms of three muscles about a ball joint.

``python -m validation.wrapping.recovery`` displaces a surface of each kind at random (``--draws N``,
``--kinds KIND ...``, ``--seed N``), by at most half the bounds of its parameters. Moment arms of the
displaced surface in 60 poses are the measurements: exact, or with independent noise of 2 mm. Least squares
starts at the nominal surface and, where it ends with a misfit above the noise, at up to five random ones.
Without noise, a surface counts as recovered if its center and sizes, and its orientation times its largest
size, are within 0.1 mm; the position of a cylinder along its axis does not change paths and is held. With
noise, the 95 % interval of each parameter, from the Jacobian and the noise, should cover the true value in 95
% of all cases.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from benchmarks.machine import pin_threads
from validation.wrapping.single_path import SurfaceDraw, wrap_object
from wrapjax.jax_setup import set_up_jax

_AROUND = (
    ((0.022, 0.12, 0.0), (0.022, -0.11, -0.004)),
    ((-0.014, 0.11, 0.018), (-0.012, -0.12, 0.018)),
    ((-0.01, 0.1, -0.02), (-0.014, -0.1, -0.018)),
)
#: Surface at the joint, and origins on ground and insertions on the moving body of three muscles, by kind; m
#: and rad. Straight lines pass the center at a distance, so that surfaces within the bounds are passed on one
#: side; those through a torus touch its ring at three places.
CASES = {
    "cylinder": (
        SurfaceDraw("cylinder", (0.03, 0.4), "x", angles=(0.2, 0.1, 0.0)),
        (
            ((0.022, 0.12, -0.03), (0.02, -0.11, -0.02)),
            ((0.018, 0.11, 0.0), (0.024, -0.12, 0.01)),
            ((0.022, 0.1, 0.03), (0.018, -0.1, 0.02)),
        ),
    ),
    "sphere": (SurfaceDraw("sphere", (0.032,), center=(0.002, -0.003, 0.0)), _AROUND),
    "ellipsoid": (SurfaceDraw("ellipsoid", (0.03, 0.036, 0.033), angles=(0.2, 0.1, 0.3)), _AROUND),
    "torus": (
        SurfaceDraw("torus", (0.02, 0.006), angles=(1.5, 0.1, 0.0)),
        (
            ((-0.06, 0.1, 0.01), (-0.06, -0.1, 0.0)),
            ((0.06, 0.1, -0.01), (0.06, -0.11, 0.01)),
            ((0.01, 0.09, 0.06), (0.0, -0.1, 0.06)),
        ),
    ),
}
#: Poses of the measured moment arms, and largest angle of each rotation (rad).
POSES, _REACH = 60, 0.3
#: Largest error that counts as recovered, and standard deviation of the noise (m).
LIMIT, NOISE = 1e-4, 2e-3
_DISPLACEMENT = 0.5
# Random starts beside the nominal surface, and misfit of moment arms that counts as exact (m).
_STARTS, _EXACT = 5, 1e-6
_NORMAL_95 = 1.959964


@dataclass(frozen=True)
class Recovery:
    """Errors of one recovered surface.

    Parameters
    ----------
    error
        Largest error of center, sizes and turned sizes without noise, m.
    covered
        Whether the interval of each parameter covers the true value with noise.
    """

    error: float
    covered: Bool[np.ndarray, " parameter"]


def write_joint(surface: SurfaceDraw, file: Path) -> None:
    """Write the model of a ball joint, three muscles and a surface on ground."""
    import opensim

    opensim.Logger.setLevelString("Off")
    model = opensim.Model()
    model.setName("ball")
    body = opensim.Body("limb", 1.0, opensim.Vec3(0), opensim.Inertia(0.1, 0.1, 0.1))
    model.addBody(body)
    frame = (opensim.Vec3(0), opensim.Vec3(0))
    joint = opensim.BallJoint("ball", model.updGround(), *frame, body, *frame)
    for axis in range(3):
        joint.upd_coordinates(axis).setName(f"rotation_{axis}")
    model.addJoint(joint)
    wrap = wrap_object(opensim, surface)
    wrap.setName("surface")
    wrap.set_translation(opensim.Vec3(*surface.center))
    wrap.set_quadrant(surface.quadrant)
    wrap.set_xyz_body_rotation(opensim.Vec3(*surface.angles))
    model.updGround().addWrapObject(wrap)
    for number, (origin, insertion) in enumerate(CASES[surface.kind][1]):
        muscle = opensim.Millard2012EquilibriumMuscle(f"muscle_{number}", 100.0, 0.1, 0.1, 0.0)
        muscle.addNewPathPoint("origin", model.updGround(), opensim.Vec3(*origin))
        muscle.addNewPathPoint("insertion", body, opensim.Vec3(*insertion))
        muscle.updGeometryPath().addPathWrap(wrap)
        model.addForce(muscle)
    model.finalizeConnections()
    model.printToXML(str(file))


def recover(kind: str, draws: int, seed: int) -> list[Recovery]:
    """Displace and recover a surface of a kind many times."""
    import jax
    import jax.numpy as jnp
    from scipy.optimize import least_squares

    from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS, PARAMETERS, PARAMETERS_OF
    from wrapjax.geometry.surrogates.wrap_bounds import USUAL_TRANSLATION, parameter_box
    from wrapjax.path_sources.muscle_paths import muscle_paths

    surface, wrap_class = CASES[kind][0], f"Wrap{kind.capitalize()}"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ball.osim"
        write_joint(surface, file)
        paths = muscle_paths(file)
    generator = np.random.default_rng(seed)
    posed = paths.posed(generator.uniform(-_REACH, _REACH, (POSES, 3)))
    free = [
        PARAMETERS.index(name)
        for name in PARAMETERS_OF[wrap_class]
        if (kind, name) != ("cylinder", "translation_z_m")
    ]
    lower, upper = (one[free] for one in parameter_box(USUAL_TRANSLATION, wrap_class, PARAMETERS))
    nominal = NOMINAL_PARAMETERS[free]
    scale = 0.5 * (upper - lower)
    starts = generator.uniform(-0.5, 0.5, (_STARTS, len(free)))

    @jax.jit
    def arms(values):
        found = posed(jnp.asarray(NOMINAL_PARAMETERS).at[jnp.asarray(free)].set(values)[None])
        return found.moment_arm.ravel(), jnp.all(found.regular), jnp.any(found.touching, axis=0)

    slopes = jax.jit(jax.jacfwd(lambda values: arms(values)[0]))

    def solve(measured, noise):
        best = None
        for start in (np.zeros(len(free)), *starts):
            found = least_squares(
                lambda unit: np.asarray(arms(jnp.asarray(nominal + scale * unit))[0]) - measured,
                start,
                lambda unit: np.asarray(slopes(jnp.asarray(nominal + scale * unit))) * scale,
                bounds=((lower - nominal) / scale - 1e-9, (upper - nominal) / scale + 1e-9),
                xtol=1e-13,
                ftol=1e-15,
                gtol=1e-15,
                max_nfev=80,
            )
            best = found if best is None or found.cost < best.cost else best
            # As small as the noise, or round-off.
            if np.sqrt(2.0 * best.cost / measured.size) < max(1.1 * noise, _EXACT):
                break
        return best

    in_meters = np.array([_length_of(PARAMETERS[place], surface) for place in free])
    recovered: list[Recovery] = []
    while len(recovered) < draws:
        true = nominal + _DISPLACEMENT * scale * generator.uniform(-1.0, 1.0, len(free))
        exact, regular, touching = (np.asarray(part) for part in arms(jnp.asarray(true)))
        if not (regular and touching.all()):
            continue
        error = float(np.max(np.abs(nominal + scale * solve(exact, 0.0).x - true) * in_meters))
        noisy = solve(exact + NOISE * generator.normal(size=exact.shape), NOISE)
        covariance = NOISE**2 * np.linalg.pinv(noisy.jac.T @ noisy.jac)
        half = _NORMAL_95 * np.sqrt(np.diag(covariance)) * scale
        recovered.append(Recovery(error, np.abs(nominal + scale * noisy.x - true) <= half))
    return recovered


def _length_of(parameter: str, surface: SurfaceDraw) -> float:
    """Displacement of the surface by a unit of a parameter, m."""
    if parameter.endswith("_m"):
        return 1.0
    sizes = surface.sizes[:1] if surface.kind == "cylinder" else surface.sizes
    return max(sizes)


def row(kind: str, found: Sequence[Recovery]) -> str:
    """Format a row of the table."""
    errors: Float[np.ndarray, " draw"] = np.array([one.error for one in found])
    covered = np.concatenate([one.covered for one in found])
    within = int((errors <= LIMIT).sum())
    return (
        f"| {kind} | {within} of {len(found)} | {1e3 * np.median(errors):.1e} | {1e3 * errors.max():.1e} | "
        f"{covered.mean():.1%} of {covered.size} |"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="recover displaced wrap surfaces from moment arms")
    parser.add_argument("--kinds", nargs="+", default=list(CASES), choices=CASES, metavar="KIND")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pin_threads()
    set_up_jax()
    print("| surface | within 0.1 mm | median error, mm | worst, mm | covered by 95 % intervals |")
    print("|---|---|---|---|---|")
    for kind in options.kinds:
        began = time.perf_counter()
        print(row(kind, recover(kind, options.draws, options.seed)), flush=True)
        print(f"{kind}: {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
