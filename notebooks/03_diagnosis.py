# %% [markdown]
# # Diagnose the remaining error of a calibrated model
#
# After calibration an error remains. It can be noise, an incomplete optimization, or an effect that the
# model leaves out, such as an orthosis, a loose electrode, or a muscle without EMG. `diagnose` compares
# a catalogue of such effects: which one best explains the residual, whether the recording can
# distinguish it from others, and how much it reduces the error on held-out cycles.
#
# Here a virtual subject wears a stiff ankle-foot orthosis that is not part of the model. The subject is
# simulated by the equations of the package itself, so the example shows the output and says nothing
# about accuracy.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path

import numpy as np

import wrapjax

wrapjax.set_up_jax()  # 64-bit numbers; compiled programs are cached for the next run

folder = Path(tempfile.mkdtemp())
wrapjax.write_virtual_subject(folder / "person", seed=3, hidden_effect="ankle_foot_orthosis")
subject = wrapjax.load_subject(folder / "person")

# %% [markdown]
# ## Run the diagnosis
#
# `diagnose` calibrates the model from several starts and to parts of the cycles, computes the signature
# of each effect of the catalogue (the change of joint moments per unit of effect size), and simulates
# null replicates to obtain the detection threshold. The most probable effects are then fitted jointly
# with all calibrated parameters. To save time only a few effects are tested here: `without` lists those
# to leave out, by default none.

# %%
TESTED = {"ankle_foot_orthosis", "curve_family", "emg_drift", "joint_damping"}
others = sorted(set(wrapjax.effect_meanings()) - TESTED)
paths = wrapjax.fit(subject, "engine")
diagnosis = wrapjax.diagnose(subject, "NGA", paths, starts=2, null_replicates=10, without=others)
found = diagnosis.result
print(diagnosis)

# %% [markdown]
# ## Error budget
#
# The mean squared error, (N m)^2, is divided into a bias, an error that repeats at all speeds, one that
# repeats at one speed, one that depends on the inputs of each cycle, and noise.

# %%
for part, values in found.budget.pooled().items():
    print(f"{part:9s}", dict(zip(found.coordinates, np.round(values, 1).tolist(), strict=True)))

# %% [markdown]
# Where in the gait cycle the error is, by coordinate and walking speed.

# %%
diagnosis.plot_error_map()

# %% [markdown]
# ## Evidence
#
# The log Bayes factor is in nats: 3 nats make a hypothesis 20 times as likely. Detectability is the
# signal-to-noise ratio, in standard deviations, of an effect of its prior size; an effect below 2
# cannot be identified in this recording.

# %%
for effect in found.effects[:5]:
    print(f"{effect.id:36s} {effect.evidence:6.1f} nats, {effect.detectability:5.1f} sd  {effect.decision}")

# %% [markdown]
# ## Refit
#
# Shrinkage is the share of the explainable error that the effect removes on held-out cycles and at a
# held-out speed. The refit also shows which calibrated parameters had compensated for the missing
# effect, by how much they change.

# %%
best = found.refits[0]
print(best.ids, best.held_out_cycles, best.held_out_speed)
moved = sorted(best.released, key=lambda one: -abs(one.after - one.before) / one.sd)
for one in moved[:5]:
    print(f"{one.label:40s} {(one.after - one.before) / one.sd:+.1f} standard deviations")

# %% [markdown]
# ## Withheld effect
#
# To check a diagnosis, leave its named effect out of the catalogue (`without`, or `--without` of the
# command); the calibration is reused. A reliable diagnosis then reports an unknown cause and does not
# name another effect.

# %%
diagnosis.save(folder / "gap")
print(sorted(path.name for path in (folder / "gap").iterdir()))
