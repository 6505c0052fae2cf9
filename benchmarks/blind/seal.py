"""The seal: hashes of cases and of their truth, fixed before any diagnosis sees a case."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path


def digest(path: Path) -> str:
    """sha256 of a file, or of a folder: of the names and the bytes of all in it."""
    if path.is_file():
        return hashlib.sha256(path.read_bytes()).hexdigest()
    whole = hashlib.sha256()
    for file in sorted(path.rglob("*")):
        if file.is_file():
            whole.update(file.relative_to(path).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return whole.hexdigest()


def seal(folder: Path) -> dict[str, dict[str, str]]:
    """Write ``manifest.json`` of a bank, sorted by id."""
    entries = {
        case.name: {
            "case": digest(case),
            "truth": digest(folder / "truth" / f"{case.name}.json"),
            "clean": digest(folder / "truth" / f"{case.name}.npy"),
        }
        for case in sorted((folder / "cases").iterdir())
    }
    text = json.dumps({"schema": 1, "cases": entries}, indent=1, sort_keys=True) + "\n"
    (folder / "manifest.json").write_text(text, encoding="utf-8", newline="\n")
    return entries


def broken_seals(folder: Path, manifest: Path | None = None) -> list[str]:
    """Say what is not as it was sealed: cases that changed, truths that changed, missing ones, extra ones."""
    sealed = json.loads((manifest or folder / "manifest.json").read_text(encoding="utf-8"))["cases"]
    faults = []
    for name, hashes in sealed.items():
        places = {"case": folder / "cases" / name}
        places |= {"truth": folder / "truth" / f"{name}.json", "clean": folder / "truth" / f"{name}.npy"}
        for kind, place in places.items():
            if not place.exists():
                faults.append(f"{kind} {name} is missing")
            elif digest(place) != hashes[kind]:
                faults.append(f"{kind} {name} is not the one that was sealed")
    extra = {path.stem for path in (folder / "truth").glob("*.json")} - set(sealed)
    return faults + [f"truth {name} was never sealed" for name in sorted(extra)]
