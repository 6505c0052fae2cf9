# %% [markdown]
# # Wrap muscles round cylinders, in two ways
#
# A muscle that runs over bone is modelled as a line that wraps round a cylinder. Where the cylinder is
# decides the muscle's moment arms, and few people have ever been measured: calibration may move it. For
# that one has to know how length and moment arms follow the cylinder, exactly.
#
# The engine lays a path in either of two ways. The *shortest* way is what a taut string does: only then are
# moment arms the derivatives of the length. *OpenSim's* way reproduces OpenSim 4.6 to rounding, with its
# defects. Here they are side by side.

# %%
import tempfile
from dataclasses import replace
from pathlib import Path

import jax

from wrapjax.jax_setup import set_up_jax

set_up_jax()  # 64 bits; what is compiled is kept for the next run

import numpy as np

import wrapjax
from wrapjax.datasets.virtual_person.subject import write_virtual_subject
from wrapjax.geometry.engine import GEODESIC, PARITY, ExactPaths, nominal_parameters, wrap_at_samples
from wrapjax.geometry.routed_path import route_path
from wrapjax.geometry.wrapping import WRAP_PARAMETERS
from wrapjax.osim.model import describe_model
from wrapjax.report.path_views import path_view_figure
from wrapjax.report.paths import MovedPath, describe_move
from wrapjax.report.wrapping_modes import compare_wrapping_modes, wrapping_modes_figure

# %% [markdown]
# ## A model as names and numbers
#
# OpenSim is asked once what its model holds. From then on nothing needs OpenSim.

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
# In this model no muscle has two cylinders; in many models the gastrocnemii do, one at the femur's condyles
# and one at the upper end of the tibia. A description is plain data, so we give this one a second cylinder.

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
# ## Paths in poses, then round cylinders
#
# Joint angles put the bones where they are; that is done once. After it, wrapping is a pure function of the
# cylinders' parameters: where they are, how they are turned, how thick they are.

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
# ## Where they differ
#
# Round one cylinder OpenSim's path is nearly the shortest, and its moment arms are off by a fraction of a
# millimeter where the path slants. Round two it may settle on a length that is no taut string's: its moment
# arms still follow the line of action, its length does not follow them.

# %%
compared = [compare_wrapping_modes(model, name, coordinates, cycle) for name in (HIP, CALF)]
for one in compared:
    print(
        f"{one.muscle:10s} moment arm from -dL/dq at most: OpenSim's way "
        f"{1e3 * one.opensim.disagreement:.2g} mm, the shortest way {1e3 * one.shortest.disagreement:.1g} mm"
    )
    assert one.shortest.disagreement < 1e-7
figure = wrapping_modes_figure(compared)
figure.savefig(folder.parent / "wrapping_modes.png", dpi=120)

# %% [markdown]
# ## How a length follows a cylinder
#
# The gradient of a length by the wrap parameters, at heel strike. Differences must agree with it to their own
# accuracy.

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
    print(f"{name}: length by wrap parameters (m a unit), by jax.grad and by differences")
    for wrap, parameter in np.ndindex(*nominal.shape):
        print(
            f"  cylinder {wrap + 1}, {WRAP_PARAMETERS[parameter]:16s} "
            f"{gradient[wrap, parameter]: .8f} {difference[wrap, parameter]: .8f}"
        )
    assert np.abs(gradient - difference).max() < 1e-7


check_gradient(HIP, 1)
check_gradient(CALF, 2)

# %% [markdown]
# ## Move a cylinder and look
#
# Ten millimeters to the front, turned by ten degrees, a tenth thicker: the path in space, before and after.

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
path_view_figure([move]).savefig(folder.parent / "moved_cylinder.png", dpi=120)

# %% [markdown]
# ## Which way feeds what
#
# - **Whatever moves cylinders: the shortest way.** PGA takes it directly (`--geometry engine`) or through a
#   surrogate. Lengths, velocities and moment arms must be one function and its derivatives, or a solver is
#   told one thing and shown another. Methods that move no cylinder take polynomials that are fitted to
#   OpenSim's paths, or to these where they are compared with PGA; `wrapjax fit --geometry` has the choice.
# - **What a model will do in OpenSim: OpenSim's way.** It is also how the engine is tested: against OpenSim
#   itself, to rounding.
#
# Where the two differ much, as round two cylinders, expect OpenSim to show another length than calibration
# used; its moment arms differ little.

# %%
print(f"figures are in {folder.parent}")
