"""The end of the demo: a virtual person with something amiss, and what a diagnosis says of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.api.diagnosing.diagnosis import Diagnosis, diagnose
from wrapjax.api.paths.fitting import fit
from wrapjax.calibrate import Watch
from wrapjax.subject import read_subject
from wrapjax.virtual import HIDDEN_EFFECTS, Series, write_virtual_subject

#: What readers of the page must not miss.
NOTE = (
    "This person walks by the package's own equations, and what was hidden in the recording has a form like "
    "the catalogue's: same-form data, a unit test and no accuracy."
)
#: Of the walking: more cycles than the demo's calibrations need, as what repeats has to be told from noise.
_SERIES = (Series(0.8, 4, 1), Series(1.2, 4, 1))
_STARTS, _TWINS = 2, 20
#: Not drawn by lot: of a size that people have it leads the list and is not named.
NOT_DRAWN = ("emg_crosstalk",)


@dataclass(frozen=True)
class GapDemonstration:
    """What was hidden in a virtual person, and what a diagnosis says."""

    #: None for nothing.
    hidden: str | None
    diagnosis: Diagnosis

    @property
    def right(self) -> bool:
        """Whether what was hidden is named, alone or in a tie; of nothing: whether nothing is."""
        result = self.diagnosis.result
        said = {*result.named, *(id for tie in result.ties for id in tie)}
        return self.hidden in said if self.hidden else not said

    @property
    def content(self) -> dict[str, Any]:
        """As ``demo.json`` has it."""
        result = self.diagnosis.result
        return {
            "hidden": self.hidden,
            "outcome": result.outcome,
            "named": result.named,
            "ties": result.ties,
            "right": self.right,
            "note": NOTE,
        }


def drawn_effect(seed: int) -> str:
    """Draw what is hidden, of `HIDDEN_EFFECTS` without `NOT_DRAWN`."""
    names = sorted(set(HIDDEN_EFFECTS) - set(NOT_DRAWN))
    return names[int(np.random.default_rng([seed, 5]).integers(len(names)))]


def demonstrate_gap(
    folder: Path,
    hidden: str | None,
    *,
    seed: int = 0,
    force: bool = False,
    quiet: bool = True,
    callback: Watch | None = None,
    tell: Callable[[str], None] = lambda line: None,
) -> GapDemonstration:
    """Make up a person with something amiss, and diagnose them.

    Parameters
    ----------
    folder
        Gets ``hidden_effect/`` (the subject) and ``gap/``.
    hidden
        One of `HIDDEN_EFFECTS`; None for nothing.
    seed, force, quiet, callback
        As of `demo`.
    tell
        As of `diagnose`.
    """
    place = folder / "hidden_effect"
    write_virtual_subject(
        place, seed=seed, moment_noise=1.0, series=_SERIES, hidden_effect=hidden, force=force
    )
    subject = read_subject(place)
    found = diagnose(
        subject,
        "NGA",
        fit(subject, "engine", seed=seed, quiet=quiet),
        starts=_STARTS,
        seed=seed,
        twins=_TWINS,
        callback=callback,
        tell=tell,
    )
    found.save(folder / "gap", force=force, note=NOTE)
    return GapDemonstration(hidden, found)
