"""Column labels: plain names, or full paths of components, as OpenSim writes them since version 4."""

from __future__ import annotations

#: The last segment of a full path that says which quantity of a component a column holds.
_QUANTITIES = ("value", "activation", "excitation")


def find_column(columns: tuple[str, ...], name: str, suffixes: tuple[str, ...] = ("",)) -> list[int]:
    """Find the columns that hold a quantity of a component, by plain label or full path.

    Parameters
    ----------
    columns
        Labels of a file.
    name
        A component, such as ``hip_flexion_r``.
    suffixes
        What may follow the name in the label, such as ``("_moment",)``; earlier ones win.

    Returns
    -------
    list of int
        Positions of the columns that match: none, one, or several where the file is ambiguous.
        ``/jointset/hip_r/hip_flexion_r/value`` matches; ``.../speed`` does not.
    """
    for suffix in suffixes:
        wanted = name + suffix
        found = [place for place, label in enumerate(columns) if wanted in (label, component_name(label))]
        if found:
            return found
    return []


def component_name(label: str) -> str:
    """Name the component that a column label is about: ``hip_flexion_r`` for its full path.

    Returns the label itself where it is a plain name or holds another quantity (``.../speed``).
    """
    if "/" not in label:
        return label
    segments = [segment for segment in label.split("/") if segment]
    if not segments:
        return label
    last = segments[-1]
    if last in _QUANTITIES and len(segments) > 1:
        return segments[-2]
    return label if last == "speed" else last
