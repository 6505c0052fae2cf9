"""Folder of a run, as ``wrapjax calibrate`` writes it, with synthetic muscle forces."""

import os
import shutil

import numpy as np

from wrapjax.io.files import write_json
from wrapjax.io.storage import Storage, write_storage
from wrapjax.model.parameters import QUANTITIES

MUSCLES = ("recfem_l", "semiten_l")


def muscle_forces(time, factor=1.0):
    """Synthetic forces (N) that differ between cycles, one row per muscle."""
    wave = np.sin(5.0 * np.asarray(time))
    return factor * np.array([400.0 + 200.0 * wave, 300.0 + 50.0 * wave**2])


def write_run(folder, subject, method="NGA", *, factor=1.0, converged=True, muscles=MUSCLES):
    """Write the folder of a run; for PGA, with the subject's own model as the personalised one."""
    trials = subject.trials
    stems = {name: {"file": name.replace("/", "_")} for name in trials.names}
    folder.mkdir(parents=True)
    summary = {"subject": subject.name, "method": method, "converged": converged, "trials": stems}
    write_json(folder / "summary.json", summary)
    settings = {
        "subject": {"folder": os.path.relpath(subject.folder, folder)},
        "method": method,
        "curves": "paper",
        "muscles": muscles,
        "coordinates": trials.moment_coordinates,
        "paths": {"source": "exact", "geometry": "engine"},
    }
    write_json(folder / "settings.json", settings)
    rows = [f"{muscle},muscle,{name},1.0,,," for muscle in muscles for name in QUANTITIES]
    table = "\n".join(["owner,kind,parameter,value,unit,lower,upper", *rows])
    (folder / "parameters.csv").write_text(f"{table}\n", encoding="utf-8")
    labels = [f"{name}_moment" for name in trials.moment_coordinates]
    for trial, entry in enumerate(stems.values()):
        time = trials.time[trial]
        force = muscle_forces(time, factor)[[MUSCLES.index(name) for name in muscles]]
        file = f"{entry['file']}.sto"
        write_storage(folder / "muscle_forces" / file, Storage("forces", muscles, time, force.T))
        moments = np.concatenate([0.5 * trials.moments[trial], trials.moments[trial]])
        columns = (*labels, *(f"{label}_measured" for label in labels))
        write_storage(folder / "moments" / file, Storage("moments", columns, time, moments.T))
    if method == "PGA":
        shutil.copy(subject.model_file, folder / "model_personalized.osim")
    return folder
