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
        # The tool finds marker files from where its settings lie, and cannot be told whether they are there.
        tool = opensim.ScaleTool(str(setup.resolve()))
        if not tool.getModelScaler().getMeasurementSet().getSize():
            message = "expected settings of OpenSim's scale tool with measurements, found none"
            raise InputError(Problem(str(setup), message))
        home = str(setup.resolve().parent) + "/"
        tool.setPathToSubject(home)
        tool.setSubjectMass(mass_kg)
        tool.getGenericModelMaker().setModelFileName(str(generic.resolve()))
        before = folder / "scaled.osim"
        after = folder / "placed.osim"
        tool.getModelScaler().setOutputModelFileName(str(before))
        tool.getModelScaler().setOutputScaleFileName("")
        tool.getMarkerPlacer().setOutputModelFileName(str(after))
        tool.getMarkerPlacer().setOutputMotionFileName("")
        tool.getMarkerPlacer().setOutputMarkerFileName("")
        done = tool.run()
        result = after if after.is_file() else before
        if not (done and result.is_file()):
            raise InputError(
                Problem(str(setup), "OpenSim's scale tool gave no model", hint="is its marker file there?")
            )
        scaled.write_bytes(result.read_bytes())
