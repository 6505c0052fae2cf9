"""Manifest of a bank: hashes of cases and of their truth, committed before any diagnosis of a case."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from validation.blind.case_selection import ALL_CASES, CaseSelection


def digest(path: Path) -> str:
    """Compute the SHA-256 of a file, or of the names and contents of all files in a folder."""
    if path.is_file():
        return hashlib.sha256(path.read_bytes()).hexdigest()
    combined = hashlib.sha256()
    for file in sorted(path.rglob("*")):
        if file.is_file():
            combined.update(file.relative_to(path).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return combined.hexdigest()


def seal(folder: Path) -> dict[str, dict[str, str]]:
    """Write ``manifest.json`` of a bank, sorted by id; return its entries."""
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


def broken_seals(
    folder: Path, manifest: Path | None = None, selection: CaseSelection = ALL_CASES
) -> list[str]:
    """Describe differences of a bank from its manifest: changed, missing or additional files or case folders.

    Only the selected cases must be present, and those that the selection leaves out are not checked.
    """
    sealed = json.loads((manifest or folder / "manifest.json").read_text(encoding="utf-8"))["cases"]
    needed = set(selection.select(sealed))
    hashes: dict[str, str] = {}
    optional: set[str] = set()
    ignored: set[str] = set()
    for name, entry in sealed.items():
        places = {"case": f"cases/{name}", "truth": f"truth/{name}.json", "clean": f"truth/{name}.npy"}
        hashes |= {place: entry[kind] for kind, place in places.items()}
        optional |= set() if name in needed else set(places.values())
        ignored |= set(places.values()) if name in selection.left_out else set()
    faults = []
    for place, expected in hashes.items():
        if place in ignored:
            continue
        if not (folder / place).exists():
            if place in optional:
                continue
            faults.append(f"{place} is missing")
        elif digest(folder / place) != expected:
            faults.append(f"{place} is not the one that was sealed")
    present = {f"{kind}/{path.name}" for kind in ("cases", "truth") for path in (folder / kind).glob("*")}
    return faults + [f"{place} was never sealed" for place in sorted(present - set(hashes))]
