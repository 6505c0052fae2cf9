"""Load an OpenSim model quietly, or say why it cannot be loaded."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem
from wrapjax.io.xml import read_xml_file

#: What OpenSim and Simbody wrap round the sentence that matters.
_WRAPPING = re.compile(
    r"std::exception in '.*?': "
    r"|SimTK Exception thrown at \S+:\d+:"
    r"|Error detected by Simbody method \w+(::\w+)*\(\): "
)
_PLACE_IN_SOURCE = re.compile(r"\s*(Thrown at \S+ in .*\.|\(Required condition .*\))")


def import_opensim() -> Any:
    """Import OpenSim and silence it.

    Its logger warns of every bone mesh that is not beside the model, and would open ``opensim.log``
    in the working folder; what is really wrong arrives as an exception anyway.
    """
    import opensim

    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Off")
    return opensim


def check_is_file(model_file: Path | str) -> Path:
    """Return the path of a model's file, or raise `InputError` if there is none."""
    path = Path(model_file)
    if not path.is_file():
        raise InputError(Problem(str(path), "is not a file; an OpenSim model (.osim) was expected"))
    return path


def load_model(model_file: Path | str) -> tuple[Any, Any]:
    """Load a model and build its system.

    Returns
    -------
    model, state
        ``opensim.Model`` and its ``State``, every coordinate at its default. Hold on to the model as
        long as to the state.

    Raises
    ------
    InputError
        If the file is not there, is no XML, holds no model, or holds one that cannot be put together.
    """
    path = check_is_file(model_file)
    _check_outermost_element(path)
    opensim = import_opensim()
    try:
        model = opensim.Model(str(path))
        state = initial_state(model)
    except RuntimeError as error:
        reason = failure_reason(error)
        raise InputError(Problem(str(path), f"OpenSim cannot load it as a model ({reason})")) from error
    if model.getBodySet().getSize() == 0:
        # OpenSim takes any of its XML files, a tool's settings for example, as an empty model.
        raise InputError(Problem(str(path), "holds no bodies; an OpenSim model (.osim) was expected"))
    return model, state


def initial_state(model: Any) -> Any:
    """Build a model's system; give its state with every coordinate at its default."""
    state = model.initSystem()
    # While it assembled the model, OpenSim may have moved coordinates a little.
    for index in range(model.getCoordinateSet().getSize()):
        coordinate = model.getCoordinateSet().get(index)
        coordinate.setValue(state, coordinate.getDefaultValue(), False)
    return state


def _check_outermost_element(path: Path) -> None:
    """Say in plain words what OpenSim says of a file that is not even its kind of XML."""
    root = read_xml_file(path)
    if root.tag != "OpenSimDocument":
        message = f"has <{root.tag}> as its outermost element, where <OpenSimDocument> was expected"
        raise InputError(Problem(str(path), message))


def failure_reason(error: RuntimeError) -> str:
    """What OpenSim complains of, on one line, without where in its source it did so."""
    text = _PLACE_IN_SOURCE.sub("", _WRAPPING.sub("", str(error)))
    return " ".join(text.split()).rstrip(".")
