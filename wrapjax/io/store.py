"""Store of results on disk, by the fingerprint of everything that decides them.

A fingerprint is a hash of the inputs and options of a computation, the version of the package, and the source
of the modules that calculate. So a result is read again only where the same computation would be repeated: a
changed formula makes results stale, and changed words in a report do not.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar

import numpy as np

from wrapjax.errors import InputError
from wrapjax.io.files import Hashed, cache_folder, content_hash, write_atomically
from wrapjax.io.json_and_arrays import load_arrays

#: Folders and modules of the package on which no calculated number depends.
_WITHOUT_NUMBERS = frozenset({"report", "cli", "progress", "renamed", "api", "__main__"})
_IMPORT = re.compile(
    r"^\s*(?:from\s+(wrapjax[\w.]*)\s+import\s+(\([^)]*\)|[^\n]*)|import\s+(wrapjax[\w.]*))", re.MULTILINE
)

Result = TypeVar("Result")


def fingerprint(*inputs: Hashed, module: str = "") -> str:
    """Compute the hash of a computation: its inputs and options, and the code of the module that makes it.

    Parameters
    ----------
    inputs
        Everything that decides the result; a `Path` stands for the bytes of its file.
    module
        Full name of the module that calculates: its source and that of all modules which it imports count,
        directly or not. By default all modules that calculate count.
    """
    return content_hash(code_hash(module), *inputs)


@cache
def code_hash(module: str = "") -> str:
    """Hash the version of the package, and the source and constants of what calculates; see `fingerprint`.

    Modules that only show results or read the command line change no number; they are left out.
    """
    package = Path(__file__).parents[1]
    chosen = _imported_by(module, package) if module else _all_modules(package)
    constants = {file for folder in {one.parent for one in chosen} for file in folder.glob("*.json")}
    return content_hash(version("wrapjax"), *sorted(chosen | constants))


def _all_modules(package: Path) -> set[Path]:
    files = package.rglob("*.py")
    return {file for file in files if not _shows_only(file.relative_to(package).with_suffix("").parts)}


def _imported_by(module: str, package: Path) -> set[Path]:
    """Find the files of a module and of all that it imports, also within functions."""
    found: set[Path] = set()
    waiting = [module]
    while waiting:
        parts = tuple(waiting.pop().split(".")[1:])
        if not parts:
            # The package itself finds every public function by its name.
            return _all_modules(package)
        file = package.joinpath(*parts).with_suffix(".py")
        file = file if file.is_file() else package.joinpath(*parts, "__init__.py")
        if file in found or _shows_only(parts) or not file.is_file():
            continue
        found.add(file)
        for origin, names, plain in _IMPORT.findall(file.read_text(encoding="utf-8")):
            # An imported name can be a module of a package.
            own = [f"{origin}.{name}" for name in re.findall(r"\w+", names)] if origin else []
            waiting += [origin or plain, *(name for name in own if origin != "wrapjax")]
    return found


def _shows_only(parts: tuple[str, ...]) -> bool:
    return bool(parts) and parts[0] in _WITHOUT_NUMBERS


@dataclass(frozen=True)
class Store:
    """Folder with results, each under its fingerprint.

    Parameters
    ----------
    folder
        Folder of the results.
    """

    folder: Path

    @classmethod
    def of_user(cls, kind: str) -> Store:
        """Return the store of one kind of result in the user's cache."""
        return cls(cache_folder(kind))

    def place(self, name: str) -> Path:
        """Return the path of a result that is a folder, whether it exists or not."""
        return self.folder / name

    def read(self, name: str, load: Callable[[Path], Result]) -> Result | None:
        """Read a result that is a folder; None if it is absent or cannot be read.

        Parameters
        ----------
        name
            Fingerprint of the result.
        load
            Function that reads the folder.
        """
        place = self.place(name)
        try:
            return load(place) if place.is_dir() else None
        except (InputError, OSError, ValueError, KeyError):
            return None

    def read_arrays(self, name: str) -> dict[str, np.ndarray] | None:
        """Read a result that consists of arrays; None if it is absent or cannot be read."""
        try:
            return load_arrays(self._file(name))
        except (OSError, ValueError):
            return None

    def write_arrays(self, name: str, **arrays: np.ndarray) -> None:
        """Write a result that consists of arrays, whole or not at all."""
        write_atomically(self._file(name), lambda file: np.savez(file, allow_pickle=False, **arrays))

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.npz"
