# %% [markdown]
# # Calibrate a leg, and check the gradients it was calibrated with
#
# A virtual person walks; its muscle parameters are known. We calibrate the model to its recorded joint
# moments, look at what came out, and then do what only a differentiable model allows: take the gradient
# of the whole objective and compare it with differences.
#
# Run it as a script, or cell by cell in any editor that knows the percent format.

# %%
import tempfile
from pathlib import Path

import jax

from wrapjax.jax_setup import set_up_jax

set_up_jax()  # 64 bits; what is compiled is kept for the next run

import jax.numpy as jnp
import numpy as np

import wrapjax
from wrapjax.datasets.virtual_person.subject import write_virtual_subject

# %% [markdown]
# ## A subject
#
# A subject is a folder: a model, and joint angles, moments and EMG of some gait cycles. Use your own in
# place of this one.

# %%
folder = Path(tempfile.mkdtemp()) / "virtual"
truth = write_virtual_subject(folder, seed=1)
subject = wrapjax.load_subject(folder)
print(f"{len(subject.muscles.names)} muscles, {len(subject.trials.names)} gait cycles")

# %% [markdown]
# ## Muscle paths as polynomials
#
# OpenSim says how long each muscle is at 500 poses, and polynomials take its place. Errors are measured on
# poses that were not used.

# %%
paths = wrapjax.fit(subject)
worst = max(paths.errors, key=lambda name: paths.errors[name].moment_arm_rmse_mm)
print(
    f"largest moment-arm error: {worst}, {paths.errors[worst].moment_arm_rmse_mm:.2f} mm (root mean square)"
)

# %% [markdown]
# ## Calibrate
#
# NGA adjusts delays, activation, EMG scales, fiber and slack lengths. Problems of this kind have several
# minima, so it runs from several starts.

# %%
calibration = wrapjax.calibrate(subject, "NGA", paths, starts=3)
result = calibration.result
print(calibration.status.value)
for outcome in result.outcomes:
    print(
        f"start {outcome.seed}: cost {outcome.solution.cost:.6f} in {outcome.solution.iterations} iterations"
    )

# %%
before = np.abs(result.initial_modelled - result.measured).mean(axis=(0, 2))
after = np.abs(result.modelled - result.measured).mean(axis=(0, 2))
for name, old, new in zip(result.coordinates, before, after, strict=True):
    print(f"{name:20s} {old:6.1f} -> {new:5.2f} N m")

# %% [markdown]
# ## The objective is a pure function
#
# It takes a tree of parameters and gives the cost; `jax.grad`, `jax.jit` and `jax.vmap` apply. Its gradient
# is exact, so differences of the cost must agree with it to their own accuracy, in any direction.

# %%
cost = wrapjax.objective(subject, "NGA", paths)
start = wrapjax.build_objective(subject, "NGA", paths).variables.base
gradient = jax.grad(cost)(start)

generator = np.random.default_rng(0)
leaves, structure = jax.tree.flatten(start)
direction = structure.unflatten(leaf * generator.normal(size=leaf.shape) for leaf in leaves)
pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(direction), strict=True)
slope = float(sum(jnp.vdot(*pair) for pair in pairs))


def moved(step: float) -> float:
    """Cost at a distance from the start, along the direction."""
    return float(cost(jax.tree.map(lambda leaf, along: leaf + step * along, start, direction)))


STEP = 1e-5
difference = (moved(STEP) - moved(-STEP)) / (2.0 * STEP)
print(f"slope by jax.grad {slope:.8g}, by differences {difference:.8g}")
assert abs(slope - difference) <= 1e-6 * abs(slope)

# %% [markdown]
# ## What the data determine
#
# Where the moments cannot tell, calibration returns what its priors say. Before believing a parameter, look
# at how much it differs between starts, and at `report.html`.

# %%
calibration.save(folder.parent / "run")
print(f"open {folder.parent / 'run' / 'report.html'} in a browser")
