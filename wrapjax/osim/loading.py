"""Import of OpenSim and loading of its models, with errors of one sentence in place of OpenSim's output."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem
from wrapjax.io.xml import read_xml_file

# What OpenSim and Simbody put before and after the message proper.
_PREFIX = re.compile(
    r"std::exception in '.*?': "
    r"|SimTK Exception thrown at \S+:\d+:"
    r"|Error detected by Simbody method \w+(::\w+)*\(\): "
)
_PLACE_IN_SOURCE = re.compile(r"\s*(Thrown at \S+ in .*\.|\(Required condition .*\))")


def import_opensim() -> Any:
    """Import OpenSim with its logger switched off.

    The logger would warn of every bone mesh that is not in the model's folder, and write ``opensim.log`` in
    the working folder. Errors are raised as exceptions in any case.
    """
    import opensim

    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Off")
    return opensim


def check_is_file(model_file: Path | str) -> Path:
    """Return the path of an existing file; raise `InputError` if there is none."""
    path = Path(model_file)
    if not path.is_file():
        raise InputError(Problem(str(path), "is not a file; an OpenSim model (.osim) was expected"))
    return path


def load_model(model_file: Path | str) -> tuple[Any, Any]:
    """Load a model and build its system.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).

    Returns
    -------
    model, state
        ``opensim.Model`` and its ``State`` with every coordinate at its default. The state is valid only as
        long as the model exists.

    Raises
    ------
    InputError
        If the file does not exist, is not XML, contains no model, or contains a model that OpenSim cannot
        build.
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
        # OpenSim loads any of its XML files, such as a tool's settings, as an empty model.
        raise InputError(Problem(str(path), "holds no bodies; an OpenSim model (.osim) was expected"))
    return model, state


def initial_state(model: Any) -> Any:
    """Build a model's system, and return its state with every coordinate at its default."""
    state = model.initSystem()
    # Assembly by OpenSim may have changed coordinates slightly.
    for index in range(model.getCoordinateSet().getSize()):
        coordinate = model.getCoordinateSet().get(index)
        coordinate.setValue(state, coordinate.getDefaultValue(), False)
    return state


def _check_outermost_element(path: Path) -> None:
    """Raise `InputError` if the file is not an OpenSim document."""
    root = read_xml_file(path)
    if root.tag != "OpenSimDocument":
        message = f"has <{root.tag}> as its outermost element, where <OpenSimDocument> was expected"
        raise InputError(Problem(str(path), message))


def failure_reason(error: RuntimeError) -> str:
    """Return OpenSim's error message on one line, without the place in its source code."""
    text = _PLACE_IN_SOURCE.sub("", _PREFIX.sub("", str(error)))
    return " ".join(text.split()).rstrip(".")
