"""Writing files whole or not at all, and naming cached results by their content.

Opening an input file, so that every reader answers the same faults in the same words.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.locks import working_alone

#: What the names of temporary files and folders end with (files: before the ending of their kind).
UNFINISHED = ".part"
_REPLACED = ".old"
#: A temporary file as old as this, in s, is nobody's any more.
_ABANDONED_S = 86_400.0


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then move it into place.

    A reader sees the old file or the new one, never a part of either. What processes left unfinished that
    were killed goes a day later.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    ending = f"{UNFINISHED}{path.suffix}"
    for left in _temporaries(path.parent, path.stem, ending):
        with suppress(OSError):
            if time.time() - left.stat().st_mtime > _ABANDONED_S:
                left.unlink()
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=ending, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        with _named(path, temporary):
            write(temporary)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def _named(path: Path, temporary: Path) -> Iterator[None]:
    """Let an error name what was to be written: of a full disk it names nothing, else what goes again."""
    try:
        yield
    except OSError as error:
        ours = error.filename is None or str(error.filename).startswith(str(temporary))
        if ours and error.errno is not None:
            raise OSError(error.errno, error.strerror or "cannot be written", str(path)) from error
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8) whole or not at all."""

    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_whole(path, write)


def write_json(path: Path, content: Any) -> None:
    """Write strict JSON (NaN and infinity become null) whole or not at all."""
    write_text(path, json.dumps(plain_values(content), indent=1, allow_nan=False) + "\n")


def plain_values(content: Any) -> Any:
    """NumPy scalars, arrays and dataclass-free containers as plain JSON values."""
    if isinstance(content, dict):
        return {str(key): plain_values(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [plain_values(value) for value in content]
    if isinstance(content, np.ndarray):
        return plain_values(content.tolist())
    if isinstance(content, np.generic):
        return plain_values(content.item())
    if isinstance(content, float) and not np.isfinite(content):
        return None
    if isinstance(content, Path):
        return str(content)
    return content


@contextmanager
def new_folder(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Fill a folder under a temporary name; it appears at ``path`` only when complete.

    A folder that exists is refused unless ``force``, and even then it is replaced only after the
    new one has been written whole. What killed processes left of the same folder is cleared away.
    """
    path = Path(path)
    with working_alone(path):
        _clear_away(path)
        with _new_folder(path, force) as folder:
            yield folder


@contextmanager
def _new_folder(path: Path, force: bool) -> Iterator[Path]:
    if path.exists() and not force:
        raise InputError(
            Problem(str(path), "exists already and is not overwritten", hint="use --force to replace it")
        )
    if path.exists() and not path.is_dir():
        raise InputError(Problem(str(path), "is a file, where a folder was expected"))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", suffix=UNFINISHED, dir=path.parent))
    except OSError as error:
        raise InputError(Problem(str(path), f"cannot be created ({error.strerror})")) from error
    try:
        with _named(path, temporary):
            yield temporary
        os.chmod(temporary, 0o755)
        if path.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{path.name}-", suffix=_REPLACED, dir=path.parent))
            os.replace(path, old / path.name)
            os.replace(temporary, path)
            shutil.rmtree(old, ignore_errors=True)
        else:
            os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _clear_away(path: Path) -> None:
    """Remove what was left of a folder by processes that were killed; nobody else may be at work there."""
    for old in _temporaries(path.parent, path.name, _REPLACED):
        # Killed between the two steps of a replacement: there is no new one, so the old one stays.
        if not path.exists() and (old / path.name).exists():
            os.replace(old / path.name, path)
        shutil.rmtree(old, ignore_errors=True)
    for left in _temporaries(path.parent, path.name, UNFINISHED):
        shutil.rmtree(left, ignore_errors=True)


def _temporaries(folder: Path, name: str, ending: str) -> list[Path]:
    """Find what `tempfile` named for a file or folder of this name."""
    fits = re.compile(rf"\.{re.escape(name)}-[a-z0-9_]{{8}}{re.escape(ending)}")
    try:
        return [Path(entry.path) for entry in os.scandir(folder) if fits.fullmatch(entry.name)]
    except OSError:
        return []


def refuse_existing(folder: Path, force: bool) -> None:
    """Say at once, not after the work, that a folder would be overwritten or cannot be made."""
    if folder.exists() and not force:
        raise InputError(
            Problem(str(folder), "exists already and is not overwritten", hint="use --force to replace it")
        )
    if folder.is_file():
        raise InputError(Problem(str(folder), "is a file, where a folder was expected"))
    parent = next(place for place in folder.absolute().parents if place.exists())
    if not parent.is_dir():
        raise InputError(Problem(str(folder), "cannot be created", hint=f"{parent} is a file"))
    try:
        # What permissions say is not all: file servers and quotas refuse what they allow.
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        hint = f"{parent} is not writable ({error.strerror})"
        raise InputError(Problem(str(folder), "cannot be created", hint=hint)) from None


def content_hash(*parts: bytes | str | np.ndarray | int | float | Path) -> str:
    """Name content by its SHA-256 (hex, 32 digits). A `Path` stands for the bytes of its file."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Path):
            piece = part.read_bytes()
        elif isinstance(part, bytes):
            piece = part
        elif isinstance(part, np.ndarray):
            array = np.ascontiguousarray(part)
            piece = f"{array.dtype.str}{array.shape}".encode() + array.tobytes()
        else:
            piece = repr(part).encode()
        digest.update(len(piece).to_bytes(8, "little"))
        digest.update(piece)
    return digest.hexdigest()[:32]


@cache
def code_hash() -> str:
    """Hash the package's version, source and constants, so that results cached by other code are not used."""
    package = Path(__file__).parents[1]
    return content_hash(version("wrapjax"), *sorted([*package.rglob("*.py"), *package.rglob("*.json")]))


def cache_folder(kind: str) -> Path:
    """The user's cache folder for one kind of result, made if needed.

    ``WRAPJAX_CACHE`` overrides the place; the default follows the XDG convention.
    """
    base = os.environ.get("WRAPJAX_CACHE")
    root = Path(base) if base else Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "wrapjax"
    folder = root / kind
    folder.mkdir(parents=True, exist_ok=True)
    return folder


#: Larger files are refused unless a reader says otherwise. An hour of 20 channels at 1 kHz has 0.8 GB.
MOST_BYTES = 2 << 30


def read_content(
    path: Path, expected: str, line_limit: int | None = None, most_bytes: int = MOST_BYTES
) -> bytes:
    """Read a file, or its first lines.

    Parameters
    ----------
    path
        The file.
    expected
        What it should be, such as ``XML``, for the message.
    line_limit
        Lines to read; all by default.
    most_bytes
        A larger file is refused.

    Raises
    ------
    InputError
        If there is no such file, it cannot be read, is empty or too large, or is a device or a pipe, which
        might have no end.
    """
    try:
        found = path.stat()
        if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
            raise InputError(Problem(str(path), f"is a device or a pipe, where {expected} was expected"))
        if line_limit is None and found.st_size > most_bytes:
            message = f"has {found.st_size >> 20} MiB, where {expected} of at most {most_bytes >> 20} MiB"
            raise InputError(Problem(str(path), f"{message} was expected"))
        if line_limit is None:
            content = path.read_bytes()
        else:
            with path.open("rb") as stream:
                # A binary file may be a single line without end.
                content = b"".join(stream.readline(1 << 20) for _ in range(line_limit))
    except FileNotFoundError:
        raise InputError(Problem(str(path), "does not exist", hint=_nearest_file(path))) from None
    except IsADirectoryError:
        raise InputError(Problem(str(path), f"is a folder, where {expected} was expected")) from None
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputError(Problem(str(path), f"cannot be read ({reason})")) from None
    if not content.strip():
        raise InputError(Problem(str(path), f"is empty, where {expected} was expected"))
    return content


def _nearest_file(path: Path) -> str:
    if not path.parent.is_dir():
        return f"the folder {path.parent} does not exist either"
    siblings = tuple(sorted(entry.name for entry in path.parent.iterdir() if entry.is_file()))
    return nearest_name(path.name, siblings) if siblings else "its folder is empty"
