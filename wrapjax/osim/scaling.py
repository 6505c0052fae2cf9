"""A generic model made as large as a person, by OpenSim's own scale tool."""

from __future__ import annotations

from pathlib import Path

from wrapjax.errors import InputError, Problem
from wrapjax.osim.loading import check_is_file, import_opensim
from wrapjax.osim.tools import running


def scale_model(generic: Path | str, setup: Path | str, mass_kg: float, scaled: Path) -> None:
    """Run ``ScaleTool`` on a static trial.

    Parameters
    ----------
    generic
        Model to be scaled.
    setup
        The tool's own settings: pairs of markers, weights, and the file of the static trial, by a path
        from the settings' folder. Its model, mass and outputs are replaced.
    mass_kg
        Of the person.
    scaled
        Where to write the model.

    Raises
    ------
    InputError
        If the settings are no settings of the tool, or it gives up.
    """
    setup = check_is_file(setup)
    generic = check_is_file(generic)
    opensim = import_opensim()
    with running("scale tool", setup) as folder:
        tool = opensim.ScaleTool(str(setup.resolve()))
        scaler, placer = tool.getModelScaler(), tool.getMarkerPlacer()
        if not scaler.getMeasurementSet().getSize():
            message = "expected settings of OpenSim's scale tool with measurements, found none"
            raise InputError(Problem(str(setup), message))
        # The tool puts its folder before every name, absolute ones too.
        tool.setPathToSubject("")
        tool.setSubjectMass(mass_kg)
        tool.getGenericModelMaker().setModelFileName(str(generic.resolve()))
        for part in (scaler, placer) if placer.getApply() else (scaler,):
            part.setMarkerFileName(str(_marker_file(setup, part.getMarkerFileName())))
        scaler.setOutputModelFileName(str(folder / "scaled.osim"))
        scaler.setOutputScaleFileName("")
        placer.setOutputModelFileName(str(folder / "placed.osim"))
        placer.setOutputMotionFileName("")
        placer.setOutputMarkerFileName("")
        # What it returns says whether markers were placed, not whether it failed.
        tool.run()
        result = folder / ("placed.osim" if placer.getApply() else "scaled.osim")
        if not result.is_file():
            raise InputError(Problem(str(setup), "OpenSim's scale tool gave no model"))
        scaled.write_bytes(result.read_bytes())


def _marker_file(setup: Path, name: str) -> Path:
    path = setup.resolve().parent / name
    if not path.is_file():
        message = f"expected the file of a static trial, found no {path}"
        raise InputError(Problem(str(setup), message, "<marker_file>"))
    return path
