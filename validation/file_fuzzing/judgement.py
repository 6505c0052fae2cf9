"""Outcome of one input: accepted, rejected with messages, or a finding."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from wrapjax.errors import InputError

ACCEPTED, REFUSED = "accepted", "refused"
#: Limit of processor time for a small input, s; wall time depends on other load.
LONGEST_S = 5.0
#: Limit of additional memory for a small input, bytes.
MEMORY_LIMIT = 512 << 20
#: Limit of the length of a message, characters: messages quote inputs only in part.
LONGEST_MESSAGE = 4000


@dataclass(frozen=True)
class Judgement:
    """Outcome of reading an input.

    Parameters
    ----------
    outcome
        `ACCEPTED`, `REFUSED`, or a finding: its kind and the line of wrapjax where it occurred.
    detail
        Traceback or message of a finding.
    """

    outcome: str
    detail: str = ""

    @property
    def finding(self) -> bool:
        """Whether the input was neither accepted nor rejected."""
        return self.outcome not in (ACCEPTED, REFUSED)


class _TooLong(BaseException):
    """Raised when the time limit is reached; no reader catches it."""


def judge(read: Callable[[], object]) -> Judgement:
    """Read an input and return the outcome."""
    try:
        with _time_limit(LONGEST_S):
            read()
    except InputError as error:
        return _judge_messages(error)
    except _TooLong as late:
        return Judgement(f"longer than {LONGEST_S:g} s at {_place(late)}", traceback.format_exc())
    except Exception as error:
        return Judgement(f"{type(error).__name__} at {_place(error)}", traceback.format_exc())
    return Judgement(ACCEPTED)


def judge_in_process(read: Callable[[], object]) -> Judgement:
    """Read an input in a separate process, because compiled code may crash it."""
    receiving, sending = os.pipe()
    process = os.fork()
    if process == 0:
        os.close(receiving)
        with contextlib.suppress(BaseException):
            limit_memory()
            judgement = judge(read)
            os.write(sending, f"{judgement.outcome}\n{judgement.detail}"[:60_000].encode(errors="replace"))
        os._exit(0)
    os.close(sending)
    began = time.monotonic()
    while os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        # Compiled code is not interrupted by the time limit.
        if time.monotonic() - began > 4.0 * LONGEST_S:
            os.kill(process, signal.SIGKILL)
        time.sleep(0.001)
    _, status = os.waitpid(process, 0)
    with os.fdopen(receiving, "rb") as stream:
        text = stream.read().decode(errors="replace")
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return Judgement(f"the process ended by {signal.Signals(number).name}")
    outcome, _, detail = text.partition("\n")
    return Judgement(outcome or "the process ended without an outcome", detail)


def limit_memory() -> None:
    """Limit the memory of this process to `MEMORY_LIMIT` more than it uses now."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_LIMIT, resource.RLIM_INFINITY))


def _judge_messages(error: InputError) -> Judgement:
    for message in map(str, error.problems):
        if not message.isprintable():
            return Judgement("message with characters that cannot be printed", repr(message))
        if len(message) > LONGEST_MESSAGE:
            return Judgement("message that is too long", message[:LONGEST_MESSAGE])
    return Judgement(REFUSED) if error.problems else Judgement("rejected without a message")


def _place(error: BaseException) -> str:
    """Return the innermost line of wrapjax in the traceback."""
    lines = [
        f"{Path(frame.filename).name}:{frame.lineno}"
        for frame in traceback.extract_tb(error.__traceback__)
        if "wrapjax/" in frame.filename
    ]
    return lines[-1] if lines else "outside wrapjax"


@contextlib.contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    def stop(*_: object) -> None:
        raise _TooLong

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
