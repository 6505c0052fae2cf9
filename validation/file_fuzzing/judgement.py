"""What becomes of one input: read, refused in sentences, or a finding."""

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
#: Longest that a small input may take, in s of the processor: others may be at work beside.
LONGEST_S = 5.0
#: Room in bytes that reading a small input may take beside what the process holds already.
ROOM = 512 << 20
#: Longest sentence, in letters: what an input holds is quoted, not copied.
LONGEST_SENTENCE = 4000


@dataclass(frozen=True)
class Judgement:
    """How an input fared.

    Parameters
    ----------
    outcome
        `ACCEPTED`, `REFUSED`, or a finding: its kind and where in our code it came up.
    detail
        Of a finding: the whole story.
    """

    outcome: str
    detail: str = ""

    @property
    def finding(self) -> bool:
        """Whether it is neither read nor refused."""
        return self.outcome not in (ACCEPTED, REFUSED)


class _TooLong(BaseException):
    """Raised at whatever is being done when time is up; nothing that reads catches it."""


def judge(read: Callable[[], object]) -> Judgement:
    """Read, and say how that went."""
    try:
        with _time_limit(LONGEST_S):
            read()
    except InputError as error:
        return _judged_sentences(error)
    except _TooLong as late:
        return Judgement(f"longer than {LONGEST_S:g} s at {_place(late)}", traceback.format_exc())
    except Exception as error:
        return Judgement(f"{type(error).__name__} at {_place(error)}", traceback.format_exc())
    return Judgement(ACCEPTED)


def judge_apart(read: Callable[[], object]) -> Judgement:
    """Read in a process of its own, which code that is not Python's may take with it."""
    receiving, sending = os.pipe()
    process = os.fork()
    if process == 0:
        os.close(receiving)
        with contextlib.suppress(BaseException):
            limit_memory()
            found = judge(read)
            os.write(sending, f"{found.outcome}\n{found.detail}"[:60_000].encode(errors="replace"))
        os._exit(0)
    os.close(sending)
    began = time.monotonic()
    while os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        # Code that is not Python's does not notice that its time is up.
        if time.monotonic() - began > 4.0 * LONGEST_S:
            os.kill(process, signal.SIGKILL)
        time.sleep(0.001)
    _, status = os.waitpid(process, 0)
    with os.fdopen(receiving, "rb") as stream:
        told = stream.read().decode(errors="replace")
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return Judgement(f"the process ended by {signal.Signals(number).name}")
    outcome, _, detail = told.partition("\n")
    return Judgement(outcome or "the process ended without a word", detail)


def limit_memory() -> None:
    """Let this process grow by `ROOM` from what it has now; beyond, memory errors are raised."""
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + ROOM, resource.RLIM_INFINITY))


def _judged_sentences(error: InputError) -> Judgement:
    for sentence in map(str, error.problems):
        if not sentence.isprintable():
            return Judgement("a sentence with letters that cannot be printed", repr(sentence))
        if len(sentence) > LONGEST_SENTENCE:
            return Judgement("a sentence without end", sentence[:LONGEST_SENTENCE])
    return Judgement(REFUSED) if error.problems else Judgement("refused without a sentence")


def _place(error: BaseException) -> str:
    """Name the innermost line of ours that was at work."""
    ours = [
        f"{Path(frame.filename).name}:{frame.lineno}"
        for frame in traceback.extract_tb(error.__traceback__)
        if "wrapjax/" in frame.filename
    ]
    return ours[-1] if ours else "nowhere of ours"


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
