# %% [markdown]
# # Muscle paths round wrapping cylinders
#
# A muscle that passes over bone is modelled as a line that wraps round a cylinder. The position of the
# cylinder determines the moment arms of the muscle, and it is rarely known for an individual, so a
# calibration can adjust it. This requires exact derivatives of path length and moment arms with respect
# to the wrap parameters.
#
# The exact engine computes paths in two ways. *Geodesic* paths are the shortest ones, for which moment
# arms are the derivatives of the length. *Parity* paths reproduce those of OpenSim 4.6 to rounding,
# including its inaccuracies. This notebook compares them.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path

import jax
import numpy as np
import opensim

import wrapjax

wrapjax.set_up_jax()  # 64-bit numbers; compiled programs are cached for the next run

# %% [markdown]
# ## A model
#
# In the virtual subject's model each muscle wraps round at most one cylinder. In many models the
# gastrocnemii wrap round two, at the femoral condyles and at the proximal tibia, so we add a second
# cylinder by OpenSim.

# %%
folder = Path(tempfile.mkdtemp()) / "virtual"
wrapjax.write_virtual_subject(folder, seed=1)
subject = wrapjax.load_subject(folder)
side = subject.side
HIP, CALF = f"iliacus_{side}", f"gasmed_{side}"

model = opensim.Model(str(subject.model_file))
shank = opensim.WrapCylinder()
shank.setName(f"Gastroc_at_shank_{side}")
condyles = opensim.WrapCylinder.safeDownCast(
    model.getBodySet().get(f"femur_{side}").getWrapObjectSet().get(f"Gastroc_at_condyles_{side}")
)
shank.set_translation(opensim.Vec3(-0.004, -0.050, condyles.get_translation()[2]))
shank.set_xyz_body_rotation(condyles.get_xyz_body_rotation())
shank.set_radius(0.030)
shank.set_length(condyles.get_length())
shank.set_quadrant(condyles.get_quadrant())
model.getBodySet().get(f"tibia_{side}").addWrapObject(shank)
model.finalizeConnections()
model.getMuscles().get(CALF).updGeometryPath().addPathWrap(shank)
model_file = folder / "two_cylinders.osim"
model.printToXML(str(model_file))

# %% [markdown]
# ## Paths as functions of poses and of wrap parameters
#
# `muscle_paths` reads the model once; computations do not use OpenSim. The result is called with poses,
# and with the wrap parameters if they are not nominal: translation, rotation and size of each surface.

# %%
trials = subject.trials
coordinates = trials.moment_coordinates
cycle = trials.angles[0, [trials.coordinates.index(name) for name in coordinates]].T
by_mode = {
    mode: wrapjax.muscle_paths(model_file, mode=mode, muscles=[HIP, CALF], coordinates=coordinates)
    for mode in ("geodesic", "parity")
}
for mode, paths in by_mode.items():
    values = paths.to_dataset(cycle).sel(pose=0, muscle=HIP)
    arm = values["moment_arm"].sel(coordinate=coordinates[0])
    print(
        f"{HIP}, {mode:8s} at heel strike: {1e3 * float(values['length']):.6f} mm, moment arm about "
        f"{coordinates[0]} {1e3 * float(arm):.4f} mm"
    )
paths = by_mode["geodesic"]
print("surfaces:", ", ".join(paths.wraps))

# %% [markdown]
# ## Differences between geodesic and parity paths
#
# Round one cylinder OpenSim's path is nearly the shortest, and its moment arms differ from -dL/dq by a
# fraction of a millimeter where the path crosses the cylinder obliquely. Round two cylinders its length
# is up to 3.5 mm less than that of the shortest path outside both: its moment arms follow the line of
# action, but its length is not consistent with them.

# %%
STEP = 1e-4
for mode, one in by_mode.items():
    moved = [
        (one(cycle - step).length - one(cycle + step).length) / (2.0 * STEP)
        for step in STEP * np.eye(len(coordinates))
    ]
    differences = np.abs(one(cycle).moment_arm - np.stack(moved, axis=1)).max(axis=(0, 1))
    for muscle, difference in zip(one.muscles, differences, strict=True):
        print(f"{muscle:10s} largest difference of moment arm from -dL/dq: {mode} {1e3 * difference:.1g} mm")
    assert mode == "parity" or (differences < 1e-7).all()
paths.plot_modes([HIP, CALF], cycle)

# %% [markdown]
# ## Derivatives with respect to wrap parameters
#
# The gradient of the path lengths with respect to the wrap parameters at heel strike, compared with
# finite differences. Each muscle has its own surfaces, so the sum of both lengths has all derivatives.

# %%
STEP = 1e-6
posed = paths.posed(cycle[:1])


@jax.jit
def total_length(parameters):
    return posed(parameters).length.sum()


gradient = np.asarray(jax.grad(total_length)(paths.nominal))
difference = np.zeros_like(paths.nominal)
for place in np.ndindex(*paths.nominal.shape):
    step = np.zeros_like(paths.nominal)
    step[place] = STEP
    ahead, behind = total_length(paths.nominal + step), total_length(paths.nominal - step)
    difference[place] = (ahead - behind) / (2.0 * STEP)
print("derivative of length by wrap parameters (m per unit), by jax.grad and by differences")
for wrap, name in enumerate(paths.wraps):
    for column, parameter in enumerate(paths.wrap_parameters[:6]):  # on which cylinders depend
        print(f"  {name:24s} {parameter:16s} {gradient[wrap, column]: .8f} {difference[wrap, column]: .8f}")
assert np.abs(gradient - difference).max() < 1e-7

# %% [markdown]
# ## Path before and after a change of the cylinder
#
# The cylinder is moved forward by 10 mm and rotated by 10 degrees, and its radius is increased by 10 %.

# %%
moved = paths.nominal
cylinder = paths.wraps.index(paths.engine.wraps_of(HIP)[0])
moved[cylinder, :6] += [0.010, 0.0, 0.0, np.deg2rad(10.0), 0.0, 0.1]
arms = [paths(cycle, own).moment_arm[:, 0, 0] for own in (paths.nominal, moved)]
frame = int(np.abs(arms[1] - arms[0]).argmax())
print(f"moment arm about {coordinates[0]}: {1e3 * arms[0][frame]:.1f} to {1e3 * arms[1][frame]:.1f} mm")
paths.plot_moved_wraps(HIP, cycle[frame], moved)

# %% [markdown]
# ## When to use which
#
# - **Geodesic paths for calibrations that adjust wrap parameters.** PGA uses them directly (`--geometry
#   engine`) or through a surrogate. Length, velocity and moment arms must be consistent derivatives of
#   one function, otherwise the solver's gradients are wrong. Methods with fixed cylinders use
#   polynomials fitted to OpenSim's paths, or to geodesic paths for a comparison with PGA (`wrapjax fit
#   --geometry`).
# - **Parity paths to predict what a model does in OpenSim.** They are also used to test the engine
#   against OpenSim.
#
# Where both differ, as for paths round two cylinders, OpenSim shows other lengths for a calibrated
# model than the calibration used; moment arms differ less.
