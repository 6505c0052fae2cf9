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
from dataclasses import replace
from pathlib import Path

import jax

from wrapjax.jax_setup import set_up_jax

set_up_jax()  # 64-bit numbers; compiled programs are cached for the next run

import numpy as np

import wrapjax
from wrapjax.datasets.virtual_person.virtual_subject import write_virtual_subject
from wrapjax.geometry.engine import GEODESIC, PARITY, ExactPaths, nominal_parameters, wrap_at_samples
from wrapjax.geometry.routed_path import route_path
from wrapjax.geometry.wrapping import WRAP_PARAMETERS
from wrapjax.osim.model import describe_model
from wrapjax.report.moved_paths import MovedPath, describe_move
from wrapjax.report.path_views import path_view_figure
from wrapjax.report.wrapping_modes import compare_wrapping_modes, wrapping_modes_figure

# %% [markdown]
# ## Model description
#
# The model is read by OpenSim once, into a description of names and numbers. Path computations do not
# use OpenSim.

# %%
folder = Path(tempfile.mkdtemp()) / "virtual"
write_virtual_subject(folder, seed=1)
subject = wrapjax.load_subject(folder)
model = describe_model(subject.model_file)
side = subject.side
for muscle in model.muscles:
    if muscle.wraps:
        print(f"{muscle.name:12s} round {', '.join(entry.wrap for entry in muscle.wraps)}")

# %% [markdown]
# In this model each muscle wraps round at most one cylinder. In many models the gastrocnemii wrap round
# two, at the femoral condyles and at the proximal tibia, so we add a second cylinder to the
# description.

# %%
HIP, CALF = f"iliacus_{side}", f"gasmed_{side}"
condyles = model.wrap(f"Gastroc_at_condyles_{side}")
shank = replace(
    condyles,
    name=f"Gastroc_at_shank_{side}",
    body=f"tibia_{side}",
    translation=(-0.004, -0.050, condyles.translation[2]),
    radius=0.030,
)
path = model.muscle(CALF)
longer = replace(path, wraps=(*path.wraps, replace(path.wraps[0], wrap=shank.name)))
model = replace(
    model,
    wraps=(*model.wraps, shank),
    muscles=tuple(longer if muscle is path else muscle for muscle in model.muscles),
)

# %% [markdown]
# ## Paths as functions of wrap parameters
#
# Path points and cylinders are first placed in the poses given by the joint angles. The wrapped path is
# then a function of the wrap parameters: translation, rotation and radius of each cylinder.

# %%
trials = subject.trials
coordinates = trials.moment_coordinates
angles = trials.angles[:, [trials.coordinates.index(name) for name in coordinates]]
cycle = angles[0].T
posed = ExactPaths(model, (HIP, CALF), coordinates).posed(cycle)
for wrapping in (GEODESIC, PARITY):
    wrapped = wrap_at_samples(posed[HIP], nominal_parameters(1)[None], wrapping)
    print(
        f"{HIP}, {wrapping.name:8s} at heel strike: {1e3 * wrapped.length[0, 0]:.6f} mm, moment arm about "
        f"{coordinates[0]} {1e3 * wrapped.moment_arm[0, 0, 0]:.4f} mm"
    )

# %% [markdown]
# ## Differences between geodesic and parity paths
#
# Round one cylinder OpenSim's path is nearly the shortest, and its moment arms differ from -dL/dq by a
# fraction of a millimeter where the path crosses the cylinder obliquely. Round two cylinders its path
# may not be the shortest: its moment arms follow the line of action, but its length is not consistent
# with them.

# %%
compared = [compare_wrapping_modes(model, name, coordinates, cycle) for name in (HIP, CALF)]
for one in compared:
    print(
        f"{one.muscle:10s} largest difference of moment arm from -dL/dq: parity "
        f"{1e3 * one.opensim.disagreement:.2g} mm, geodesic {1e3 * one.shortest.disagreement:.1g} mm"
    )
    assert one.shortest.disagreement < 1e-7
figure = wrapping_modes_figure(compared)
figure.savefig(folder.parent / "wrapping_modes.png", dpi=120)
figure

# %% [markdown]
# ## Derivatives with respect to wrap parameters
#
# The gradient of the path length with respect to the wrap parameters at heel strike, compared with finite
# differences.

# %%
STEP = 1e-6


def check_gradient(name, wraps):
    def length(parameters):
        return posed[name].wrapped(parameters).length[0]

    both = jax.jit(jax.value_and_grad(length))
    nominal = nominal_parameters(wraps)
    gradient = np.asarray(both(nominal)[1])
    difference = np.zeros_like(nominal)
    for place in np.ndindex(*nominal.shape):
        step = np.zeros_like(nominal)
        step[place] = STEP
        difference[place] = (both(nominal + step)[0] - both(nominal - step)[0]) / (2.0 * STEP)
    print(f"{name}: derivative of length by wrap parameters (m per unit), by jax.grad and by differences")
    for wrap, parameter in np.ndindex(*nominal.shape):
        print(
            f"  cylinder {wrap + 1}, {WRAP_PARAMETERS[parameter]:16s} "
            f"{gradient[wrap, parameter]: .8f} {difference[wrap, parameter]: .8f}"
        )
    assert np.abs(gradient - difference).max() < 1e-7


check_gradient(HIP, 1)
check_gradient(CALF, 2)

# %% [markdown]
# ## Path before and after a change of the cylinder
#
# The cylinder is moved forward by 10 mm and rotated by 10 degrees, and its radius is increased by 10 %.

# %%
moved = nominal_parameters(1)
moved[0] += [0.010, 0.0, 0.0, np.deg2rad(10.0), 0.0, 0.1]
both = np.stack([nominal_parameters(1), moved])
arms = wrap_at_samples(posed[HIP], both).moment_arm[:, :, 0]
frame = int(np.abs(arms[1] - arms[0]).argmax())
move = MovedPath(
    muscle=HIP,
    coordinate=coordinates[0],
    trial=trials.names[0],
    percent=round(100 * frame / (len(cycle) - 1)),
    arm_before=float(arms[0][frame]),
    arm_after=float(arms[1][frame]),
    before=route_path(model, HIP, coordinates, cycle[frame]),
    after=route_path(model, HIP, coordinates, cycle[frame], moved),
)
for pair in move.touched:
    print(describe_move(*pair))
print(f"moment arm about {move.coordinate}: {1e3 * move.arm_before:.1f} to {1e3 * move.arm_after:.1f} mm")
figure = path_view_figure([move])
figure.savefig(folder.parent / "moved_cylinder.png", dpi=120)
figure

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
