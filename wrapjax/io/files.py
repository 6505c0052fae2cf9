"""Atomic writing of files, locks of folders, bounded reading of input files, content hashes, cache folder.

A file or folder is written under a temporary name and moved into place when it is complete, so that a failed
or killed process leaves no partial result. A folder is locked while it is written, so that two runs do not
write the same one at the same time. All readers of input files use `read_content`, so that a missing,
empty or too large file gives the same error message everywhere.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import socket
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import platformdirs

from wrapjax.errors import InputError, Problem, nearest_name

#: Suffix of the names of temporary files and folders (of files: before the suffix of their format).
PART_SUFFIX = ".part"
#: Suffix of the temporary folder that holds a folder while it is replaced.
_OLD_SUFFIX = ".old"
#: Age in s from which a temporary file is taken to be left by a killed process.
_ABANDONED_AGE_S = 86_400.0
#: Number of nested locks that this process holds, by folder.
_held: dict[Path, int] = {}


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file under a temporary name in the same folder, then move it into place.

    A reader sees the old file or the complete new file. Temporary files left by killed processes are deleted
    after a day.

    Parameters
    ----------
    path
        File to write or replace; its folder is created if needed.
    write
        Function that writes the content to the temporary path that it receives.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    ending = f"{PART_SUFFIX}{path.suffix}"
    for abandoned in _temporary_paths(path.parent, path.stem, ending):
        with suppress(OSError):
            if time.time() - abandoned.stat().st_mtime > _ABANDONED_AGE_S:
                abandoned.unlink()
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=ending, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        with _errors_naming(path, temporary):
            write(temporary)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def _errors_naming(path: Path, temporary: Path) -> Iterator[None]:
    """Replace the temporary path, or no path (full disk), in an `OSError` by the path of the final file."""
    try:
        yield
    except OSError as error:
        concerns_temporary = error.filename is None or str(error.filename).startswith(str(temporary))
        if concerns_temporary and error.errno is not None:
            raise OSError(error.errno, error.strerror or "cannot be written", str(path)) from error
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8) atomically."""

    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_atomically(path, write)


def write_json(path: Path, content: Any) -> None:
    """Write strict JSON atomically; NaN and infinity become null."""
    write_text(path, json.dumps(to_json_values(content), indent=1, allow_nan=False) + "\n")


def to_json_values(content: Any) -> Any:
    """Convert NumPy scalars and arrays, paths and containers of them to plain JSON values."""
    if isinstance(content, dict):
        return {str(key): to_json_values(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [to_json_values(value) for value in content]
    if isinstance(content, np.ndarray):
        return to_json_values(content.tolist())
    if isinstance(content, np.generic):
        return to_json_values(content.item())
    if isinstance(content, float) and not np.isfinite(content):
        return None
    if isinstance(content, Path):
        return str(content)
    return content


@contextmanager
def new_folder(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Create a folder atomically: yield a temporary folder and move it to ``path`` when the block ends.

    Temporary folders that killed processes left for the same path are deleted.

    Parameters
    ----------
    path
        Folder to create.
    force
        Replace an existing folder, after the new one is complete.

    Yields
    ------
    Path
        Temporary folder to write into.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is false, ``path`` is a file, or the folder cannot be created.
    BusyError
        If another process writes the same folder.
    """
    path = Path(path)
    with lock_folder(path):
        _delete_abandoned(path)
        with _new_folder(path, force) as folder:
            yield folder


@contextmanager
def _new_folder(path: Path, force: bool) -> Iterator[Path]:
    _check_replaceable(path, force)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", suffix=PART_SUFFIX, dir=path.parent))
    except OSError as error:
        raise InputError(Problem(str(path), f"cannot be created ({error.strerror})")) from error
    try:
        with _errors_naming(path, temporary):
            yield temporary
        os.chmod(temporary, 0o755)
        if path.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{path.name}-", suffix=_OLD_SUFFIX, dir=path.parent))
            os.replace(path, old / path.name)
            os.replace(temporary, path)
            shutil.rmtree(old, ignore_errors=True)
        else:
            os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _delete_abandoned(path: Path) -> None:
    """Delete temporary folders that killed processes left; the caller must hold the folder's lock."""
    for old in _temporary_paths(path.parent, path.name, _OLD_SUFFIX):
        # The process was killed between the two steps of a replacement: the old folder is restored.
        if not path.exists() and (old / path.name).exists():
            os.replace(old / path.name, path)
        shutil.rmtree(old, ignore_errors=True)
    for abandoned in _temporary_paths(path.parent, path.name, PART_SUFFIX):
        shutil.rmtree(abandoned, ignore_errors=True)


def _temporary_paths(folder: Path, name: str, ending: str) -> list[Path]:
    """Find temporary files or folders that `tempfile` created for a file or folder of this name."""
    pattern = re.compile(rf"\.{re.escape(name)}-[a-z0-9_]{{8}}{re.escape(ending)}")
    try:
        return [Path(entry.path) for entry in os.scandir(folder) if pattern.fullmatch(entry.name)]
    except OSError:
        return []


def _check_replaceable(folder: Path, force: bool) -> None:
    if folder.exists() and not force:
        raise InputError(
            Problem(str(folder), "exists already and is not overwritten", hint="use --force to replace it")
        )
    if folder.exists() and not folder.is_dir():
        raise InputError(Problem(str(folder), "is a file, where a folder was expected"))


def check_output_folder(folder: Path, force: bool) -> None:
    """Check before a long computation that its output folder can be created.

    Parameters
    ----------
    folder
        Output folder.
    force
        Whether an existing folder may be replaced.

    Raises
    ------
    InputError
        If the folder exists and must not be replaced, is a file, or cannot be created.
    """
    _check_replaceable(folder, force)
    parent = next(place for place in folder.absolute().parents if place.exists())
    if not parent.is_dir():
        raise InputError(Problem(str(folder), "cannot be created", hint=f"{parent} is a file"))
    try:
        # File servers and quotas can refuse what the permissions allow, so that writing is tried.
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        hint = f"{parent} is not writable ({error.strerror})"
        raise InputError(Problem(str(folder), "cannot be created", hint=hint)) from None


#: What can be hashed; a `Path` stands for the bytes of its file.
Hashed = bytes | str | np.ndarray | int | float | Path


def content_hash(*parts: Hashed) -> str:
    """Compute the SHA-256 of values (first 32 hex digits); a `Path` stands for the bytes of its file."""
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


def cache_folder(kind: str) -> Path:
    """Return the user's cache folder for one kind of result, created if needed.

    The environment variable ``WRAPJAX_CACHE`` sets the parent folder; the default is that of the operating
    system (``~/.cache/wrapjax`` on Linux).
    """
    base = os.environ.get("WRAPJAX_CACHE")
    folder = (Path(base) if base else platformdirs.user_cache_path("wrapjax", appauthor=False)) / kind
    folder.mkdir(parents=True, exist_ok=True)
    return folder


#: Default largest size of an input file, bytes. An hour of 20 channels at 1 kHz has 0.8 GB.
MAX_BYTES = 2 << 30


def read_content(
    path: Path, expected: str, line_limit: int | None = None, max_bytes: int = MAX_BYTES
) -> bytes:
    """Read the bytes of a file, or of its first lines.

    Parameters
    ----------
    path
        File to read.
    expected
        Expected kind of file, such as ``XML``, for error messages.
    line_limit
        Number of lines to read; all lines by default.
    max_bytes
        Largest accepted size of the file, bytes.

    Raises
    ------
    InputError
        If the file does not exist, cannot be read, is empty or too large, or is a device or a pipe (reading
        these may never end).
    """
    try:
        status = path.stat()
        if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
            raise InputError(Problem(str(path), f"is a device or a pipe, where {expected} was expected"))
        if line_limit is None and status.st_size > max_bytes:
            message = f"has {status.st_size >> 20} MiB, where {expected} of at most {max_bytes >> 20} MiB"
            raise InputError(Problem(str(path), f"{message} was expected"))
        if line_limit is None:
            content = path.read_bytes()
        else:
            with path.open("rb") as stream:
                # A binary file may be a single very long line.
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


class BusyError(InputError):
    """Another run writes the same folder."""


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes for the duration of a block; locks of one process may be nested.

    The file ``.NAME.lock`` beside the folder is locked and holds the process number and the computer's name.
    The operating system releases the lock when the process ends, even if it is killed.

    Raises
    ------
    BusyError
        If another run has locked the folder.
    """
    place = Path(os.path.realpath(folder.absolute().parent)) / folder.absolute().name
    if not place.name:  # The root of the file system is never an output folder.
        yield
        return
    if _held.get(place):
        _held[place] += 1
        try:
            yield
        finally:
            _held[place] -= 1
        return
    with _temporary_parents(place.parent):
        lock = place.with_name(f".{place.name}.lock")
        handle = _acquire(lock, folder)
        _held[place] = 1
        try:
            yield
        finally:
            del _held[place]
            if handle is not None:
                # Deleted before it is released: a process that has the file open notices that it was deleted.
                # Windows does not delete an open file; it stays, unlocked.
                with suppress(PermissionError):
                    lock.unlink(missing_ok=True)
                os.close(handle)


@contextmanager
def _temporary_parents(parent: Path) -> Iterator[None]:
    """Create a folder and its parents; delete those that are still empty when the block ends."""
    above = (parent, *parent.parents)
    missing = [place for place in above if not place.exists()]
    if os.access(above[len(missing)], os.W_OK):
        with suppress(OSError):
            parent.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        for place in missing:
            with suppress(OSError):
                place.rmdir()


def _acquire(lock: Path, folder: Path) -> int | None:
    """Lock a file and return its handle; None if it cannot be locked (writing then raises the error)."""
    while True:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError:
            return None
        try:
            if not filelock.lock_descriptor(handle, blocking=False):
                raise BusyError(
                    Problem(
                        str(folder),
                        f"is being written by another run ({_holder(handle) or 'just started'})",
                        hint="wait until it ends, or choose another folder",
                    )
                )
            if _is_current(handle, lock):
                os.ftruncate(handle, 0)
                os.write(handle, f"process {os.getpid()} on {socket.gethostname()}".encode())
                return handle
        except BusyError:
            os.close(handle)
            raise
        except OSError:  # a file system without locks, or a full one
            os.close(handle)
            return None
        os.close(handle)


def _holder(handle: int) -> str:
    """Read who holds a lock; Windows does not let others read a locked file."""
    try:
        return os.read(handle, 200).decode(errors="replace")
    except PermissionError:
        return ""


def _is_current(handle: int, lock: Path) -> bool:
    """Return whether an open file is still the file of that name."""
    try:
        return os.path.samestat(os.fstat(handle), lock.stat())
    except FileNotFoundError:
        return False
