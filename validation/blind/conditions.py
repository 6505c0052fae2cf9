"""Pairs of recordings of one person, with and without the cause of a case of a bank that was made.

The person walks once more without the cause: other cycles by the same habits, with the same muscles, units of
EMG, model file and background. A cause in the body's geometry or in the laboratory's model would be in both,
so such cases are left out, and so are cases of several causes or of one outside the catalogue.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from validation.blind.background import background_of, with_background
from validation.blind.case import record_with_noise, write_recorded
from validation.blind.make import person_of, variants_of
from validation.blind.plan import Bank, PlannedCase, plan_cases, settings_of

#: Causes that no condition of a person has alone.
CONSTANT = frozenset(
    {"bound_pressure", "hip_center_offset", "joint_axis_rotation", "muscle_attachment", "wrap_surface"}
)


def make_pairs(banks: Sequence[Bank], folder: Path, out: Path) -> int:
    """Write ``cases/<id>/with``, ``cases/<id>/without`` and the truth of every pair.

    Parameters
    ----------
    banks
        Parts of the bank, as it was made.
    folder
        Folder of the bank; its cases that were not made have no pair.
    out
        Folder of the pairs. Pairs that are there are kept.

    Returns
    -------
    count
        Number of pairs.
    """
    count = 0
    for bank in banks:
        for planned in plan_cases(bank, variants_of(settings_of(bank, bank.first_person))):
            truth = folder / "truth" / f"{planned.id}.json"
            if planned.tier not in ("none", "single") or not truth.exists():
                continue
            facts = json.loads(truth.read_text(encoding="utf-8"))
            causes = [cause["id"] for cause in facts["causes"]]
            if CONSTANT.intersection(causes):
                continue
            count += 1
            if not (out / "cases" / planned.id).exists():
                _make_pair(bank, planned, facts["person"], folder, out)
                print(planned.id, *causes, file=sys.stderr, flush=True)
    return count


def _make_pair(bank: Bank, planned: PlannedCase, person: str, folder: Path, out: Path) -> None:
    index = next(one for one in bank.persons if f"{bank.name}_{one:02d}" == person)
    session = (bank.seed, 5, planned.order)
    who = person_of(bank, index, session)
    world = with_background(who.world, background_of(who, (bank.seed, 4, index)))
    clean, noise, emg = record_with_noise(world, planned.level, np.random.default_rng((*session, 1)))
    recorded = {"moments": clean.moments + noise, "emg": emg, "pose": clean.pose, "ground": clean.ground}
    work = out / "work" / planned.id
    shutil.rmtree(work, ignore_errors=True)
    write_recorded(work / "without", who, who.nominal, recorded)
    shutil.copytree(folder / "cases" / planned.id, work / "with")
    for kind in ("cases", "truth"):
        (out / kind).mkdir(parents=True, exist_ok=True)
    shutil.copy(folder / "truth" / f"{planned.id}.json", out / "truth")
    work.rename(out / "cases" / planned.id)
