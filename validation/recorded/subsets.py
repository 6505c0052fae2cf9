"""Diagnoses of parts of untouched recordings: ``python -m validation.recorded.subsets --out DIR``.

Nothing is added to the recordings, and their true causes are unknown. But parts of one recording are of one
person on one day: halves of the cycles, each speed, and all coordinates but one must not be given names that
contradict each other. The table counts such names, and how often nothing is named. Answers are stored in DIR,
so that an interrupted run can be continued.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
import tomllib
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from benchmarks.machine import pin_threads
from validation.diagnosis.case_answers import Job, answer
from validation.recorded.recordings import add_subjects_argument
from wrapjax.cohorts.scheduling import run_jobs
from wrapjax.diagnosis.effects.catalogue import family_of
from wrapjax.errors import InputError
from wrapjax.io.toml import toml_list

#: Folders of $WRAPJAX_DATA that are diagnosed by default.
PEOPLE = ("s1_left", "healthy_treadmill", "healthy_running")
#: Outcomes by which a diagnosis says that it names nothing.
SILENT = ("none", "unknown", "insufficient_data", "not_converged")


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    # Import JAX after the arguments are checked.
    from wrapjax.subject.subject import load_subject

    out = options.out.resolve()
    try:
        for person in options.subjects:
            load_subject(person)
        folders = [part for person in options.subjects for part in write_parts(person, out / "subjects")]
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    jobs = {part.name: Job(part, out / "answers" / part.name, options.starts) for part in folders}
    failed = 0
    for number, one in enumerate(run_jobs(answer, jobs, workers=options.workers), 1):
        failed += bool(one.failure)
        text = f"FAILED: {one.failure}" if one.failure else one.value
        print(f"{number}/{len(jobs)} {one.name}: {text}", file=sys.stderr, flush=True)
    found = {
        name: json.loads((job.answer / "gap.json").read_text(encoding="utf-8"))
        for name, job in jobs.items()
        if (job.answer / "gap.json").exists()
    }
    print(table(found), end="")
    return 1 if failed else 0


def write_parts(person: Path, folder: Path) -> list[Path]:
    """Write a subject folder for the whole recording and for each of its parts.

    Parameters
    ----------
    person
        Valid subject folder.
    folder
        Where the copies are written, named after person and part.
    """
    written = []
    for name, text in parts_of((person / "subject.toml").read_text(encoding="utf-8")).items():
        part = folder / f"{person.name}.{name}"
        if not (part / "subject.toml").exists() or (part / "subject.toml").read_text("utf-8") != text:
            shutil.rmtree(part, ignore_errors=True)
            shutil.copytree(person, part)
            (part / "subject.toml").write_text(text, encoding="utf-8")
        written.append(part)
    return written


def parts_of(settings: str) -> dict[str, str]:
    """Return the settings of a subject (the text of ``subject.toml``) for each part of its recording."""
    head, *trials = re.split(r"(?m)^(?=\[\[trial\]\])", settings)
    known = tomllib.loads(settings)
    parts = {"all": settings}
    for name, rest in (("odd_cycles", 0), ("even_cycles", 1)):
        parts[name] = head + "".join(_every_second_cycle(trials, rest))
    speeds = [str(trial["speed_m_s"]) for trial in known["trial"] if "speed_m_s" in trial]
    for speed in dict.fromkeys(speeds) if len(set(speeds)) > 1 else ():
        own = [text for text, trial in zip(trials, known["trial"], strict=True) if _has_speed(trial, speed)]
        parts[f"speed_{speed}"] = head + "".join(own)
    coordinates = known["model"]["coordinates"]
    for left_out in coordinates if len(coordinates) > 1 else ():
        kept = toml_list([name for name in coordinates if name != left_out])
        parts[f"without_{left_out}"] = re.sub(
            r"(?m)^coordinates\s*=\s*\[.*?\]", f"coordinates = {kept}", settings
        )
    return parts


def _has_speed(trial: Mapping[str, Any], speed: str) -> bool:
    return str(trial.get("speed_m_s")) == speed


def _every_second_cycle(trials: Sequence[str], rest: int) -> list[str]:
    """Keep every second calibration cycle of each speed, and all others."""
    kept: list[str] = []
    seen: dict[float | None, int] = {}
    for text in trials:
        (trial,) = tomllib.loads(text)["trial"]
        if trial["use"] != "calibration":
            kept.append(text)
        elif "cycles" in trial:
            pairs = ", ".join(f"[{start}, {end}]" for start, end in trial["cycles"][rest::2])
            kept.append(re.sub(r"(?ms)^cycles\s*=\s*\[\[.*?\]\]", f"cycles = [{pairs}]", text))
        else:
            speed = trial.get("speed_m_s")
            seen[speed] = seen.get(speed, -1) + 1
            kept += [text] if seen[speed] % 2 == rest else []
    return kept


def contradictions(found: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str]]:
    """List pairs of parts of one person whose claims share no effect and no family.

    Parameters
    ----------
    found
        Content of ``gap.json`` by name of the part, ``person.part``.
    """
    claims = {name: _claim(gap) for name, gap in found.items()}
    return [
        (one, other)
        for one, other in combinations(claims, 2)
        if one.split(".")[0] == other.split(".")[0]
        and claims[one]
        and claims[other]
        and not claims[one] & claims[other]
    ]


def _claim(gap: Mapping[str, Any]) -> set[str]:
    """List the effects that are named or tied, and their families or the family that is named."""
    effects = [*gap["named"], *(id for tie in gap["ties"] for id in tie)]
    family = gap.get("family") or ""
    return {*effects, *map(family_of, effects), *([family] if family else [])}


def table(found: Mapping[str, Mapping[str, Any]]) -> str:
    """Format a Markdown table of all parts, and the counts of contradictions and silence."""
    lines = [
        "| recording | part | outcome | named | strongest effects (probability) | error left, usual (N m) |",
        "|---|---|---|---|---|---|",
    ]
    for name, gap in found.items():
        person, _, part = name.partition(".")
        claimed = [*gap["named"], *(id for tie in gap["ties"] for id in tie), gap.get("family") or ""]
        named = ", ".join(f"`{id}`" for id in claimed if id) or "-"
        ranked = sorted(gap["effects"], key=lambda one: -(one["probability"] or 0.0))[:3]
        strongest = ", ".join(f"`{one['id']}` {one['probability'] or 0.0:.2f}" for one in ranked)
        adequate = (gap.get("gates") or {}).get("adequate") or {}
        left = (
            f"{adequate['left_rms_Nm']:.1f}, {adequate['floor_rms_Nm']:.1f}"
            if adequate.get("left_rms_Nm") is not None
            else "-"
        )
        lines.append(f"| {person} | {part} | {gap['outcome']} | {named} | {strongest} | {left} |")
    silent = sum(gap["outcome"] in SILENT for gap in found.values())
    against = contradictions(found)
    lines += ["", f"Contradicting pairs of parts: {len(against)}. Nothing named: {silent} of {len(found)}."]
    lines += [f"- {one} and {other}" for one, other in against]
    return "\n".join(lines) + "\n"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.recorded.subsets", description=__doc__)
    add_subjects_argument(parser, PEOPLE)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--starts", type=int, default=4)
    return parser


if __name__ == "__main__":
    sys.exit(main())
