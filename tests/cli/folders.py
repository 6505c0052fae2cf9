"""Contents of output folders, hidden files included."""

import json
from pathlib import Path
from typing import Any

METHOD = ("--method", "NGA")
MUSCLES = ["recfem_l", "semiten_l"]
COORDINATES = ["hip_flexion_l", "knee_angle_l"]


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def content(folder: Path) -> dict[str, bytes | None]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


def read_json(file: Path) -> Any:
    """Read strict JSON."""

    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    return json.loads(file.read_text(encoding="utf-8"), parse_constant=refuse)
