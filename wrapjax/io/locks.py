"""Lock of an output folder, so that two runs do not write the same folder at the same time."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from wrapjax.errors import InputError, Problem

try:
    import fcntl
except ImportError:  # On Windows folders are not locked.
    fcntl = None  # type: ignore[assignment]

#: Number of nested locks that this process holds, by folder.
_held: dict[Path, int] = {}


class BusyError(InputError):
    """Another run writes the same folder."""


@contextlib.contextmanager
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
                lock.unlink(missing_ok=True)
                os.close(handle)


@contextlib.contextmanager
def _temporary_parents(parent: Path) -> Iterator[None]:
    """Create a folder and its parents; delete those that are still empty when the block ends."""
    above = (parent, *parent.parents)
    missing = [place for place in above if not place.exists()]
    if os.access(above[len(missing)], os.W_OK):
        with contextlib.suppress(OSError):
            parent.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        for place in missing:
            with contextlib.suppress(OSError):
                place.rmdir()


def _acquire(lock: Path, folder: Path) -> int | None:
    """Lock a file and return its handle; None if it cannot be locked (writing then raises the error)."""
    while fcntl is not None:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError:
            return None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_current(handle, lock):
                os.truncate(handle, 0)
                os.write(handle, f"process {os.getpid()} on {socket.gethostname()}".encode())
                return handle
        except BlockingIOError:
            holder = os.read(handle, 200).decode(errors="replace")
            os.close(handle)
            message = f"is being written by another run ({holder or 'just started'})"
            hint = "wait until it ends, or choose another folder"
            raise BusyError(Problem(str(folder), message, hint=hint)) from None
        except OSError:  # a file system without locks, or a full one
            os.close(handle)
            return None
        os.close(handle)
    return None


def _is_current(handle: int, lock: Path) -> bool:
    """Return whether an open file is still the file of that name."""
    try:
        return os.path.samestat(os.fstat(handle), lock.stat())
    except FileNotFoundError:
        return False
