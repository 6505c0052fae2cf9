"""Faults put into one interval of recorded walking, and whether `wrapjax check` names them.

``python -m validation.recorded.injected_faults`` copies the recording ``healthy_treadmill`` of the folder in
``WRAPJAX_DATA``, adds one fault to its EMG in an interval of 12 s, and looks for a finding of that kind that
names the channel. It also lists what is found in the recordings as they are, beside what is known of them.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from wrapjax.io.storage import find_columns, read_storage, write_storage
from wrapjax.preprocessing.checks.recording_findings import Finding, recording_findings
from wrapjax.subject.subject import load_subject

#: What is known of the recordings as they are: kind and channel of a finding, and the reason for it.
KNOWN = {
    (
        "s1_left",
        "baseline",
        "SemiMemb",
    ): "one of eight cycles of a hemiparetic person, semimembranosus active "
    "throughout: physiology or a loose electrode, which the recording cannot tell",
}
RECORDINGS = ("s1_left", "healthy_overground", "healthy_treadmill", "healthy_running")
#: Interval with the fault, s.
INTERVAL = (20.0, 32.0)

Change = Callable[[dict[str, np.ndarray]], None]


def baseline(channel: str, level: float) -> Change:
    """Raise a channel by a constant level."""

    def change(signals: dict[str, np.ndarray]) -> None:
        signals[channel] += level

    return change


def exchange(first: str, second: str) -> Change:
    """Exchange two channels."""

    def change(signals: dict[str, np.ndarray]) -> None:
        signals[first][:], signals[second][:] = signals[second].copy(), signals[first].copy()

    return change


def lose(channel: str) -> Change:
    """Replace a channel by a small constant."""

    def change(signals: dict[str, np.ndarray]) -> None:
        signals[channel][:] = 0.01

    return change


def faults(channels: tuple[str, ...]) -> dict[str, tuple[str, tuple[str, ...], Change]]:
    """List ten faults: name, kind of the finding, channels that it must name, and the change."""
    calf, shin, thigh, *others = channels
    return {
        f"baseline of {calf}": ("baseline", (calf,), baseline(calf, 0.06)),
        f"baseline of {shin}": ("baseline", (shin,), baseline(shin, 0.08)),
        f"baseline of {thigh}": ("baseline", (thigh,), baseline(thigh, 0.1)),
        f"baseline of {others[0]}": ("baseline", (others[0],), baseline(others[0], 0.08)),
        f"{calf} and {shin} exchanged": ("swapped channels", (calf, shin), exchange(calf, shin)),
        f"{shin} and {thigh} exchanged": ("swapped channels", (shin, thigh), exchange(shin, thigh)),
        f"{calf} and {others[0]} exchanged": (
            "swapped channels",
            (calf, others[0]),
            exchange(calf, others[0]),
        ),
        f"{calf} lost": ("lost channel", (calf,), lose(calf)),
        f"{shin} lost": ("lost channel", (shin,), lose(shin)),
        f"{others[0]} lost": ("lost channel", (others[0],), lose(others[0])),
    }


def findings_after(source: Path, change: Change) -> tuple[Finding, ...]:
    """Copy a subject folder, change its EMG in the interval, and return what is found."""
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as place:
        folder = Path(shutil.copytree(source, Path(place) / source.name))
        subject = load_subject(folder)
        file = subject.recordings[0].emg
        assert file is not None
        table = read_storage(file)
        values = table.values.copy()
        inside = (table.time >= INTERVAL[0]) & (table.time <= INTERVAL[1])
        columns = {name: find_columns(table.columns, name)[0] for name in subject.trials.channels}
        signals = {name: values[inside, column].copy() for name, column in columns.items()}
        change(signals)
        for name, column in columns.items():
            values[inside, column] = signals[name]
        file.unlink()
        write_storage(file, replace(table, values=values))
        return recording_findings(load_subject(folder))


def main() -> int:
    """Print which faults are named, and what is found in recordings as they are."""
    data = Path(os.environ["WRAPJAX_DATA"])
    source = data / "healthy_treadmill"
    channels = load_subject(source).trials.channels
    named = 0
    listed = faults(channels)
    for label, (kind, expected, change) in listed.items():
        found = findings_after(source, change)
        hits = [one for one in found if one.kind == kind and set(one.subjects) == set(expected)]
        named += bool(hits)
        others = [f"{one.kind} of {', '.join(one.subjects)}" for one in found if one not in hits]
        print(f"{label}: {'named' if hits else 'MISSED'}; besides: {'; '.join(others) or 'nothing'}")
    print(f"named: {named} of {len(listed)}")
    unknown = 0
    for name in RECORDINGS:
        for one in recording_findings(load_subject(data / name)):
            reason = KNOWN.get((name, one.kind, ", ".join(one.subjects)))
            unknown += reason is None
            print(f"{name} as it is: {one.sentence} [{reason or 'NOT KNOWN'}]")
    print(f"findings without a known reason: {unknown}")
    return 0 if named == len(listed) and not unknown else 1


if __name__ == "__main__":
    sys.exit(main())
