# %% [markdown]
# # What does the model still lack?
#
# A calibrated model never fits perfectly. What is left can be noise; it can be that a fit was not finished;
# or something is at work that no parameter stands for: an orthosis, an electrode that comes loose, a muscle
# that nobody recorded. `diagnose` asks of a catalogue of such effects which one the remaining error speaks
# for, whether the recording can tell at all, and how far the error shrinks on cycles that no fit has seen.
#
# Here a virtual person wears a stiff orthosis that no file tells of. It walks by the package's own equations:
# this shows what the answer looks like, and is no accuracy.

# %%
import tempfile
from pathlib import Path

from wrapjax.jax_setup import set_up_jax

set_up_jax()  # 64 bits; what is compiled is kept for the next run

import numpy as np

import wrapjax
from wrapjax.cli.diagnose import diagnosis_table
from wrapjax.datasets.virtual_person.subject import write_virtual_subject
from wrapjax.diagnosis.effects.catalogue import CATALOGUE

folder = Path(tempfile.mkdtemp())
write_virtual_subject(folder / "person", seed=3, hidden_effect="ankle_foot_orthosis")
subject = wrapjax.load_subject(folder / "person")

# %% [markdown]
# ## Ask
#
# That calibrates the model from several starts, fits it to parts of the cycles, draws what each effect of the
# catalogue would do to the moments, and makes people with nothing amiss to learn how much evidence they show.
# The likeliest effects are then fitted together with everything else. To be quick we ask for a few effects
# only: `without` names those to leave out, and without it the whole catalogue is asked.

# %%
ASKED = {"ankle_foot_orthosis", "curve_family", "emg_drift", "joint_damping"}
others = sorted(set(CATALOGUE) - ASKED)
paths = wrapjax.fit(subject, "engine")
diagnosis = wrapjax.diagnose(subject, "NGA", paths, starts=2, null_replicates=10, without=others)
found = diagnosis.result
print(diagnosis_table(found))

# %% [markdown]
# ## Where
#
# The error is split exactly into a bias, what repeats at all speeds, what repeats at one, what follows the
# inputs of each cycle, and noise: mean squares, in (N m)^2.

# %%
for part, values in found.budget.pooled().items():
    print(f"{part:9s}", dict(zip(found.coordinates, np.round(values, 1).tolist(), strict=True)))

# %% [markdown]
# ## Which
#
# Evidence is in nats: 3 make one hypothesis 20 times as likely as the other. Detectability says how many
# standard deviations an effect of expected size would show; below 2 the recording cannot tell, whatever comes
# out.

# %%
for effect in found.effects[:5]:
    print(f"{effect.id:36s} {effect.evidence:6.1f} nats, {effect.detectability:5.1f} sd  {effect.decision}")

# %% [markdown]
# ## How far
#
# Of the error that a better model could take away, the share that is gone on left-out cycles and at the other
# speed. And what calibration had put in the effect's place: parameters that stood elsewhere to hide it.

# %%
best = found.alternatives[0]
print(best.ids, best.held_out_cycles, best.held_out_speed)
moved = sorted(best.released, key=lambda one: -abs(one.after - one.before) / one.sd)
for one in moved[:5]:
    print(f"{one.label:40s} {(one.after - one.before) / one.sd:+.1f} standard deviations")

# %% [markdown]
# ## If nobody knew of orthoses
#
# An effect can be left out of the catalogue (`without`, or `--without` of the command); the calibration is
# not done again. What should come out then is that something is amiss, not another name. Whoever trusts an
# answer should try it.

# %%
diagnosis.save(folder / "gap")
print(sorted(path.name for path in (folder / "gap").iterdir()))
