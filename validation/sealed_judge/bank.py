"""Plan and make a bank of cases; verify it."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .anatomy import CHANNEL_NAMES
from .case_files import write_case
from .detect import Detector
from .effect import Effect
from .effects import CATALOGUE, EFFECTS, OUTSIDE
from .movements import RUNNING, SQUATS, add_movement
from .other_tasks import add_tasks
from .person import Person, draw_person
from .session import Session, Take

CASES_PER_PERSON = 5
SHARES = {"none": 0.3, "single": 0.5, "outside": 0.1, "pair": 0.1}
#: Share of detectable cases whose d* lies between 2 and 5; the others lie above 5, most of them below 25.
WEAK = 0.3


def plan(cases: int, seed: int) -> list[dict]:
    """Return identifier, person, tier, stratum and preferred effects of every case, in random order.

    Parameters
    ----------
    cases : int
        Number of cases.
    seed : int
        Seed of the bank.

    Returns
    -------
    list of dict
        One entry per case.
    """
    rng = np.random.default_rng([seed, 5])
    counts = {t: int(np.floor(s * cases)) for t, s in SHARES.items()}
    for tier in ("single", "none", "outside", "pair"):
        if sum(counts.values()) < cases:
            counts[tier] += 1
    tiers = [t for t, n in counts.items() for _ in range(n)]
    tiers = [tiers[i] for i in rng.permutation(len(tiers))][:cases]
    decks: dict[str, list[Any]] = {"single": [], "outside": [], "pair": []}
    sources = {"single": CATALOGUE, "outside": OUTSIDE, "pair": CATALOGUE}
    weak_deck: list[bool] = []
    out = []
    for i, tier in enumerate(tiers):
        entry: dict[str, Any] = {
            "id": f"case{i + 1:03d}",
            "person": i // CASES_PER_PERSON,
            "tier": tier,
            "wanted": [],
            "weak": [],
        }
        for _ in range({"none": 0, "pair": 2}.get(tier, 1)):
            deck = decks[tier]
            if len(deck) < 2:
                deck += [sources[tier][k] for k in rng.permutation(len(sources[tier]))]
            choice = next(e for e in deck if e not in entry["wanted"])
            deck.remove(choice)
            if not weak_deck:
                weak_deck = [bool(x) for x in rng.permutation([True] * 3 + [False] * 7)]
            entry["wanted"].append(choice)
            entry["weak"].append(weak_deck.pop())
        out.append(entry)
    return out


def draw_effect(
    detector: Detector,
    person: Person,
    rng: np.random.Generator,
    wanted: str,
    weak: bool,
    pool: tuple[str, ...],
) -> tuple[Effect, float]:
    """Draw an effect and the size that gives a d* in its stratum.

    Parameters
    ----------
    detector : Detector
        Detectability of the session.
    person : Person
        The person.
    rng : numpy.random.Generator
        Source.
    wanted : str
        Effect to try first.
    weak : bool
        Whether d* must lie in 2..5, otherwise above 5.
    pool : tuple of str
        Effects to fall back on.

    Returns
    -------
    tuple of Effect and float
        The effect with its size, and its d*.

    Raises
    ------
    RuntimeError
        When no effect of the pool reaches the stratum.
    """
    order = [wanted, wanted, wanted, *(str(x) for x in rng.permutation(list(pool)))]
    for name in order:
        kind = EFFECTS[name]
        low, high = kind.limits
        sign = int(rng.choice(kind.signs))
        goal = float(rng.uniform(2.4, 4.6)) if weak else float(5.5 * np.exp(rng.uniform(0, np.log(4.5))))
        inner = int(rng.integers(2**31))
        size = float(np.sqrt(low * high))
        for trial in range(6):
            effect = kind(sign * size, np.random.default_rng(inner), person)
            value = detector.evaluate([effect], adapt=1)[0]
            new = float(np.clip(size * np.clip(goal / max(value, 1e-3), 0.1, 10.0), low, high))
            # Near enough, at a limit of the published range, or out of trials.
            settled = abs(new / size - 1) < 0.12 or trial == 5
            if settled:
                value = detector.evaluate([effect])[0]
                if (2 <= value <= 5) if weak else value > 5:
                    return effect, value
            if abs(new / size - 1) < 0.02:
                break
            size = new
    raise RuntimeError(f"no effect reaches the stratum of {wanted}")


@dataclass
class Drawn:
    """What one entry of the plan is drawn to be: session, causes with their d*, and true states."""

    person: Person
    session: Session
    seed: int
    effects: list[Effect]
    values: list[float]
    takes: list[Take]
    d_star: float


def draw_case(entry: dict, seed: int) -> Drawn:
    """Draw the person, the session and the causes of one entry of the plan."""
    number = int(entry["id"][4:])
    person = draw_person(
        int(np.random.default_rng([seed, 7, entry["person"]]).integers(2**31)), f"P{entry['person'] + 1:02d}"
    )
    session_seed = int(np.random.default_rng([seed, 9, number]).integers(2**31))
    session = Session(person, session_seed)
    rng = np.random.default_rng([seed, 13, number])
    effects: list[Effect] = []
    values: list[float] = []
    takes, d_star = session.takes, 0.0
    if entry["tier"] != "none":
        detector = Detector(session, session_seed)
        pool = OUTSIDE if entry["tier"] == "outside" else CATALOGUE
        for wanted, weak in zip(entry["wanted"], entry["weak"], strict=True):
            rest = tuple(i for i in pool if i not in {e.id for e in effects})
            effect, value = draw_effect(detector, person, rng, wanted, weak, rest)
            effects.append(effect)
            values.append(value)
        d_star, _, takes = detector.evaluate(effects)
    return Drawn(person, session, session_seed, effects, values, takes, d_star)


#: What adds trials of other tasks to a case, by name: of a dynamometer, squats, or running.
ADDED: dict[str, Callable[..., None]] = {
    "dynamometer": add_tasks,
    "squats": lambda *case: add_movement(SQUATS, *case),
    "running": lambda *case: add_movement(RUNNING, *case),
}


def add_other_tasks(out: Path, entry: dict, seed: int, target: Path, kind: str) -> str:
    """Write one case with trials of other tasks (`ADDED`) beside walking, unless it is there already."""
    name = entry["id"]
    if not (target / "cases" / name).exists():
        drawn = draw_case(entry, seed)
        (target / "cases").mkdir(parents=True, exist_ok=True)
        truth = json.loads((out / "truth" / f"{name}.json").read_text(encoding="utf-8"))
        scale = np.array([truth["emg_scale"][channel] for channel in CHANNEL_NAMES])
        case = (out / "cases" / name, target / "cases" / name)
        ADDED[kind](*case, drawn.session, drawn.effects, drawn.seed, scale)
        (target / "truth").mkdir(exist_ok=True)
        shutil.copy(out / "truth" / f"{name}.json", target / "truth" / f"{name}.json")
    return name


def add_condition(out: Path, entry: dict, seed: int, target: Path) -> str:
    """Write one case, and the same person walking without its cause in ``<id>/without``, unless it is there.

    Only cases with nothing amiss, or with one cause that a condition can have: a cause in the body's geometry
    or in the laboratory's model would be in both.
    """
    name, place = entry["id"], target / "cases" / entry["id"]
    truth = out / "truth" / f"{name}.json"
    if place.exists() or entry["tier"] not in ("none", "single"):
        return name
    drawn = draw_case(entry, seed)
    constant = (type(one).true_leg is not Effect.true_leg or type(one).lab_leg is not Effect.lab_leg
                for one in drawn.effects)  # fmt: skip
    if any(constant):
        return name
    facts = json.loads(truth.read_text(encoding="utf-8"))
    scale = np.array([facts["emg_scale"][channel] for channel in CHANNEL_NAMES])
    other_seed = int(np.random.default_rng([seed, 53, int(name[4:])]).integers(2**31))
    without = Session(drawn.person, other_seed)
    work = place.with_name(name + ".part")
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(out / "cases" / name, work / "with")
    write_case(work / "without", name, without, without.takes, [], other_seed, (drawn.seed, scale))
    (target / "truth").mkdir(exist_ok=True)
    shutil.copy(truth, target / "truth" / truth.name)
    work.rename(place)
    return name


def with_conditions(out: Path, target: Path, workers: int) -> None:
    """Write a bank of people who walk with and without the cause of a case."""
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    seed, entries = manifest["seed"], plan(manifest["cases"], manifest["seed"])
    count = len(entries)
    (target / "cases").mkdir(parents=True, exist_ok=True)
    _run(workers, add_condition, [out] * count, entries, [seed] * count, [target] * count)
    names = sorted(path.name for path in (target / "cases").iterdir())
    kept = {"seed": seed, "cases": count, "sha256": {name: digest(target, name) for name in names}}
    (target / "manifest.json").write_text(json.dumps(kept, indent=1), encoding="utf-8")


def _run(workers: int, work: Callable[..., str], *arguments: list) -> None:
    """Do the work for each set of arguments, in processes of their own where there are several workers."""
    if workers == 1:
        for name in map(work, *arguments):
            print(name, flush=True)
        return
    with ProcessPoolExecutor(workers) as pool:
        for name in pool.map(work, *arguments):
            print(name, flush=True)


def with_other_tasks(out: Path, target: Path, workers: int, kind: str) -> None:
    """Write a bank whose people also did other tasks (`ADDED`); their walking is the same."""
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    seed, entries = manifest["seed"], plan(manifest["cases"], manifest["seed"])
    count = len(entries)
    _run(workers, add_other_tasks, [out] * count, entries, [seed] * count, [target] * count, [kind] * count)
    digests = {entry["id"]: digest(target, entry["id"]) for entry in entries}
    kept = {"seed": seed, "cases": count, "sha256": digests}
    (target / "manifest.json").write_text(json.dumps(kept, indent=1), encoding="utf-8")


def make_case(out: Path, entry: dict, seed: int) -> str:
    """Make one case unless it is there already, and return its identifier."""
    case, truth_file = out / "cases" / entry["id"], out / "truth" / f"{entry['id']}.json"
    if truth_file.exists():
        return entry["id"]
    drawn = draw_case(entry, seed)
    person, session, effects, takes = drawn.person, drawn.session, drawn.effects, drawn.takes
    values, session_seed, d_star = drawn.values, drawn.seed, drawn.d_star
    work = case.with_name(case.name + ".part")
    shutil.rmtree(work, ignore_errors=True)
    shutil.rmtree(case, ignore_errors=True)
    facts = write_case(work, entry["id"], session, takes, effects, session_seed)
    work.rename(case)
    causes = [{**e.describe(), "d_star": round(v, 3)} for e, v in zip(effects, values, strict=True)]
    truth = {
        "id": entry["id"],
        "person": person.name,
        "tier": entry["tier"],
        "causes": causes,
        "d_star": round(d_star, 3),
        "families": sorted({e.family for e in effects}),
        "side": person.side,
        "speeds_m_s": list(person.speeds),
        "noise": person.noise,
        **facts,
    }
    truth_file.parent.mkdir(parents=True, exist_ok=True)
    part = truth_file.with_suffix(".part")
    part.write_text(json.dumps(truth, indent=1), encoding="utf-8")
    os.replace(part, truth_file)
    return entry["id"]


def digest(out: Path, name: str) -> dict[str, str]:
    """Return the sha256 of the truth file and of all files of a case (paths and contents)."""
    total = hashlib.sha256()
    for file in sorted((out / "cases" / name).rglob("*")):
        if file.is_file():
            total.update(
                str(file.relative_to(out)).encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest()
            )
    return {
        "truth": hashlib.sha256((out / "truth" / f"{name}.json").read_bytes()).hexdigest(),
        "case": total.hexdigest(),
    }


def make(out: Path, cases: int, seed: int, workers: int) -> None:
    """Make the bank and its manifest."""
    out.mkdir(parents=True, exist_ok=True)
    entries = plan(cases, seed)
    record, text = out / "truth" / "plan.txt", f"seed {seed} cases {cases}\n"
    record.parent.mkdir(exist_ok=True)
    if record.exists() and record.read_text(encoding="utf-8") != text:
        raise SystemExit(f"{out} holds another bank: {record.read_text(encoding='utf-8').strip()}")
    record.write_text(text, encoding="utf-8")
    _run(workers, make_case, [out] * cases, entries, [seed] * cases)
    manifest = {"seed": seed, "cases": cases, "sha256": {e["id"]: digest(out, e["id"]) for e in entries}}
    (out / "manifest.json").write_text(json.dumps(manifest, indent=1), encoding="utf-8")


def check(out: Path) -> list[str]:
    """Return a sentence for every case that differs from the manifest."""
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    wrong = []
    for name, kept in manifest["sha256"].items():
        try:
            now = digest(out, name)
        except OSError as error:
            wrong.append(f"{name}: {error}")
            continue
        wrong += [f"{name}: {part} differs from the manifest" for part in kept if kept[part] != now[part]]
    return wrong
