# %% [markdown]
# # Calibrate a leg, and check the gradients of the objective
#
# We calibrate the EMG-driven model of a virtual subject, whose true muscle parameters are known, to its
# joint moments during walking. Then we compute the gradient of the objective by automatic
# differentiation and compare it with finite differences.
#
# This notebook is kept as a script, too: `notebooks/01_calibrate.py`.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import wrapjax

wrapjax.set_up_jax()  # 64-bit numbers; compiled programs are cached for the next run

# %% [markdown]
# ## A subject
#
# A subject is a folder with an OpenSim model and joint angles, joint moments and EMG envelopes of
# several gait cycles. Here a virtual subject is simulated; you can load your own folder instead.

# %%
folder = Path(tempfile.mkdtemp()) / "virtual"
wrapjax.write_virtual_subject(folder, seed=1)
subject = wrapjax.load_subject(folder)
print(f"{len(subject.muscles.names)} muscles, {len(subject.trials.names)} gait cycles")

# %% [markdown]
# ## Muscle paths as polynomials
#
# OpenSim computes the length and moment arms of each muscle in 500 poses, and polynomials are fitted to
# them. Errors are evaluated in poses that were not used for fitting.

# %%
paths = wrapjax.fit(subject)
worst = max(paths.errors, key=lambda name: paths.errors[name].moment_arm_rmse_mm)
print(
    f"largest moment arm error: {worst}, {paths.errors[worst].moment_arm_rmse_mm:.2f} mm (root mean square)"
)

# %% [markdown]
# ## Calibrate
#
# NGA adjusts electromechanical delays, activation parameters, EMG scale factors, optimal fiber lengths
# and tendon slack lengths; muscle paths are fixed. The objective has several local minima, so the
# calibration is run from several starting points.

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
# One calibration cycle: the measured moments, those of the model before calibration, and after.

# %%
phase = np.linspace(0.0, 100.0, result.measured.shape[-1])
figure = Figure(figsize=(9.0, 2.6), layout="constrained")
for axes, name, measured, first, last in zip(
    figure.subplots(1, len(result.coordinates)),
    result.coordinates,
    result.measured[0],
    result.initial_modelled[0],
    result.modelled[0],
    strict=True,
):
    axes.plot(phase, measured, "k", label="measured")
    axes.plot(phase, first, "C1:", label="before")
    axes.plot(phase, last, "C0", label="after")
    axes.set(title=name, xlabel="gait cycle (%)")
figure.axes[0].set_ylabel("joint moment (N m)")
figure.axes[0].legend(frameon=False)
figure

# %% [markdown]
# ## The objective is a pure function
#
# `wrapjax.objective` returns the cost as a function of the parameter tree, to which `jax.grad`,
# `jax.jit` and `jax.vmap` can be applied. Its gradient is exact, so it must agree with finite
# differences of the cost in any direction, within the accuracy of the differences.

# %%
cost = wrapjax.objective(subject, "NGA", paths)
start = wrapjax.build_objective(subject, "NGA", paths).variables.base
gradient = jax.grad(cost)(start)

generator = np.random.default_rng(0)
leaves, structure = jax.tree.flatten(start)
direction = structure.unflatten(leaf * generator.normal(size=leaf.shape) for leaf in leaves)
pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(direction), strict=True)
slope = float(sum(jnp.vdot(*pair) for pair in pairs))


def cost_along(step: float) -> float:
    """Compute the cost at a distance from the start along the direction."""
    return float(cost(jax.tree.map(lambda leaf, along: leaf + step * along, start, direction)))


STEP = 1e-5
difference = (cost_along(STEP) - cost_along(-STEP)) / (2.0 * STEP)
print(f"slope by jax.grad {slope:.8g}, by differences {difference:.8g}")
assert abs(slope - difference) <= 1e-6 * abs(slope)

# %% [markdown]
# ## What the data determine
#
# Parameters that the joint moments do not determine stay near their prior means. Before interpreting a
# parameter, check how much it differs between starts, and the intervals in `report.html`.

# %%
calibration.save(folder.parent / "run")
print(sorted(path.name for path in (folder.parent / "run").iterdir()))
