"""One run at a time for one folder of results."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from wrapjax.errors import InputError, Problem

try:
    import fcntl
except ImportError:  # not on Windows, where nobody is kept out
    fcntl = None  # type: ignore[assignment]

#: Folders that this process works for, by how many of its functions do.
_held: dict[Path, int] = {}


class BusyError(InputError):
    """Another run is at work in the same folder."""


@contextlib.contextmanager
def working_alone(folder: Path) -> Iterator[None]:
    """Keep other processes from writing the same folder meanwhile; within one process it may be asked twice.

    A file ``.NAME.lock`` beside the folder is locked, and says who did that. The system lets go of it when
    the process ends, however it ends: what a killed run leaves bars nobody's way.

    Raises
    ------
    BusyError
        If another run is at work.
    """
    place = Path(os.path.realpath(folder.absolute().parent)) / folder.absolute().name
    if not place.name:  # the whole file system, where nothing is ever written
        yield
        return
    if _held.get(place):
        _held[place] += 1
        try:
            yield
        finally:
            _held[place] -= 1
        return
    with _folders(place.parent):
        lock = place.with_name(f".{place.name}.lock")
        handle = _locked(lock, folder)
        _held[place] = 1
        try:
            yield
        finally:
            del _held[place]
            if handle is not None:
                # Before it is let go of: who finds none makes one, who has it open sees that it is gone.
                lock.unlink(missing_ok=True)
                os.close(handle)


@contextlib.contextmanager
def _folders(parent: Path) -> Iterator[None]:
    """Make a folder, and those above it; take away again what of them stays empty."""
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


def _locked(lock: Path, folder: Path) -> int | None:
    """Lock a file; None where that cannot be done: whoever then writes says why nothing can be written."""
    while fcntl is not None:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError:
            return None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is(handle, lock):
                os.truncate(handle, 0)
                os.write(handle, f"process {os.getpid()} on {socket.gethostname()}".encode())
                return handle
        except BlockingIOError:
            who = os.read(handle, 200).decode(errors="replace")
            os.close(handle)
            message = f"is being written by another run ({who or 'just begun'})"
            raise BusyError(Problem(str(folder), message, hint="wait for it, or write elsewhere")) from None
        except OSError:  # a file system without locks, or a full one
            os.close(handle)
            return None
        os.close(handle)
    return None


def _is(handle: int, lock: Path) -> bool:
    """Say whether a file that was opened is still the one of that name."""
    try:
        return os.path.samestat(os.fstat(handle), lock.stat())
    except FileNotFoundError:
        return False
