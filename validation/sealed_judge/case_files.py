"""Write one case as the subject folder a lab would hand over."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np

from . import anatomy
from .effect import Effect, Measured
from .model_file import write_model
from .muscle import RATE
from .session import Session, Take
from .signals import envelope, moment_noise, session_peak

JOINT_OF = {"hip_flexion": "hip", "hip_adduction": "hip", "hip_rotation": "hip", "knee_angle": "knee",
            "ankle_angle": "ankle", "subtalar_angle": "subtalar"}  # fmt: skip


def write_table(
    path: Path,
    title: str,
    columns: list[str],
    time: np.ndarray,
    values: np.ndarray,
    degrees: bool = False,
    sto: bool = True,
) -> None:
    """Write an OpenSim storage file."""
    head = [
        title,
        f"version={3 if title == 'Coordinates' else 1}",
        f"nRows={len(time)}",
        f"nColumns={len(columns) + 1}",
        f"inDegrees={'yes' if degrees else 'no'}",
    ]
    if sto:
        head.insert(1, "DataType=double")
    text = "\n".join([*head, "endheader", "\t".join(["time", *columns])]) + "\n"
    body = np.column_stack([time, values])
    lines = ["\t".join([f"{row[0]:.5f}", *(f"{x:.7g}" for x in row[1:])]) for row in body]
    path.write_text(text + "\n".join(lines) + "\n", encoding="utf-8")


@contextmanager
def added_trials(case: Path, out: Path) -> Iterator[tuple[Path, list[str]]]:
    """Copy a case; yield the copy and the lines its settings get. It appears whole or not at all."""
    work = out.with_name(out.name + ".part")
    lines: list[str] = []
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(case, work)
    yield work, lines
    file = work / "subject.toml"
    file.write_text(file.read_text(encoding="utf-8") + "\n".join(lines) + "\n", encoding="utf-8")
    shutil.rmtree(out, ignore_errors=True)
    work.rename(out)


def external_loads(side: str) -> str:
    """Return the external-loads file of the one instrumented foot."""
    return f"""<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40000">
\t<ExternalLoads name="externalloads">
\t\t<objects>
\t\t\t<ExternalForce name="foot_{side}">
\t\t\t\t<applied_to_body>calcn_{side}</applied_to_body>
\t\t\t\t<force_expressed_in_body>ground</force_expressed_in_body>
\t\t\t\t<point_expressed_in_body>ground</point_expressed_in_body>
\t\t\t\t<force_identifier>ground_force_{side}_v</force_identifier>
\t\t\t\t<point_identifier>ground_force_{side}_p</point_identifier>
\t\t\t\t<torque_identifier>ground_torque_{side}_</torque_identifier>
\t\t\t</ExternalForce>
\t\t</objects>
\t\t<groups />
\t\t<datafile>ground_forces.mot</datafile>
\t</ExternalLoads>
</OpenSimDocument>
"""


def _subject(session: Session, name: str, angles: str) -> str:
    """Return subject.toml."""
    p = session.person
    side = p.side
    used = ", ".join(f'"{anatomy.COORDS[k]}_{side}"' for k in anatomy.USED)
    lines = [
        "[subject]", f'name = "{name}"', f"mass_kg = {p.mass:.1f}", f'side = "{side}"', "",
        "[model]", 'file = "model.osim"', f"coordinates = [{used}]", "",
        "[emg]", 'kind = "envelope"', "[emg.channels]",
    ]  # fmt: skip
    for channel, members in anatomy.CHANNELS.items():
        lines.append(f"{channel} = [{', '.join(f'{chr(34)}{m}_{side}{chr(34)}' for m in members)}]")
    for i, (take, (calibration, _)) in enumerate(zip(session.takes, session.cycles, strict=True)):
        events = take.view.rec.events
        pairs = [f"[{a:.4f}, {b:.4f}]" for a, b in pairwise(events)]
        folder = f"trials/speed{i + 1}"
        for use, chosen in (("calibration", pairs[:calibration]), ("validation", pairs[calibration:])):
            if not chosen:
                continue
            lines += [
                "", "[[trial]]", f'name = "speed{i + 1}_{use}"', f'use = "{use}"',
                f"speed_m_s = {take.view.rec.speed:.2f}",
                f'angles = "{folder}/{angles}"', f'moments = "{folder}/moments.sto"',
                f'emg = "{folder}/emg.sto"',
                f'ground_forces = "{folder}/ground_forces.mot"',
                f'external_loads = "{folder}/external_loads.xml"',
                f"cycles = [{', '.join(chosen)}]",
            ]  # fmt: skip
    return "\n".join(lines) + "\n"


def write_trial(
    folder: Path, m: Measured, moments: np.ndarray, emg: np.ndarray, take: Take, side: str, full: bool
) -> None:
    """Write the files of one recording."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = take.view.rec.kept
    start = kept.start + kept.start % 2
    slow, fast = slice(start, kept.stop, 2), slice(start, kept.stop)
    time = take.view.rec.time
    left = side == "l"
    pelvis = m.pelvis * (np.array([1, -1, -1, 1, 1, -1]) if left else 1.0)
    if full:
        names = [f"/jointset/ground_pelvis/{c}/value" for c in anatomy.PELVIS_COORDS]
        names += [f"/jointset/{JOINT_OF[c]}_{side}/{c}_{side}/value" for c in anatomy.COORDS]
    else:
        names = [*anatomy.PELVIS_COORDS, *(f"{c}_{side}" for c in anatomy.COORDS)]
    angles = np.hstack([pelvis, m.q])
    degrees = not full
    if degrees:
        angles[:, [0, 1, 2, *range(6, 12)]] = np.degrees(angles[:, [0, 1, 2, *range(6, 12)]])
    file = folder / ("angles.sto" if full else "angles.mot")
    write_table(file, "Coordinates", names, time[slow], angles[slow], degrees)
    write_table(
        folder / "moments.sto", "Inverse Dynamics Generalized Forces",
        [f"{c}_{side}_moment" for c in anatomy.COORDS],
        time[slow], moments[slow],
    )  # fmt: skip
    write_table(folder / "emg.sto", "Electromyography", list(anatomy.CHANNEL_NAMES), time[fast], emg[fast])
    flip = np.array([1, 1, -1]) if left else np.ones(3)
    torque = np.zeros((len(m.free), 3))
    torque[:, 1] = m.free * (-1 if left else 1)
    columns = [f"ground_force_{side}_{a}{x}" for a in "vp" for x in "xyz"] + [
        f"ground_torque_{side}_{x}" for x in "xyz"
    ]
    write_table(
        folder / "ground_forces.mot", "ground_forces", columns, time[fast],
        np.hstack([m.force * flip, m.cop * flip, torque])[fast], sto=False,
    )  # fmt: skip
    (folder / "external_loads.xml").write_text(external_loads(side), encoding="utf-8")


def write_case(
    folder: Path,
    name: str,
    session: Session,
    takes: list[Take],
    effects: Sequence[Effect],
    seed: int,
    beside: tuple[int, np.ndarray] | None = None,
) -> dict:
    """Write a case and return what the recordings contain.

    Parameters
    ----------
    folder : Path
        Folder of the case.
    name : str
        Subject name; says nothing about the effects.
    session : Session
        Session without effects.
    takes : list of Take
        True states with effects.
    effects : sequence of Effect
        Effects at work.
    seed : int
        Seed of the noise.
    beside : tuple of int and ndarray, optional
        Seed of the noise of another condition of the same person, and the drive of each electrode at an
        envelope of one there: formats, units of EMG and the errors that repeat are the same in both.

    Returns
    -------
    dict
        Normalising maxima of the electrodes and similar facts.
    """
    folder.mkdir(parents=True, exist_ok=True)
    p = session.person
    lab = p.lab_leg
    for effect in effects:
        lab = effect.lab_leg(lab)
    write_model(folder / "model.osim", lab, p.lab_muscles, p.side, name)
    rng = np.random.default_rng([seed, 41])
    repeating = rng if beside is None else np.random.default_rng([beside[0], 41])
    # Half of the labs write radians under full path names, half degrees under plain names.
    full = bool(repeating.integers(2))
    angles = "angles.sto" if full else "angles.mot"
    (folder / "subject.toml").write_text(_subject(session, name, angles), encoding="utf-8")
    noise = moment_noise(rng, p, [t.view for t in takes], session.peak, repeating)
    peak = session_peak(session.takes)
    emg = [envelope(t, peak, effects, rng, p.noise["emg_cv"]) for t in takes]
    top = np.max([e[t.view.rec.kept].max(axis=0) for e, t in zip(emg, takes, strict=True)], axis=0)
    if beside is not None:
        top = beside[1] / peak
    measured = session.measure(takes, effects)
    for i, (take, (m, moments), e) in enumerate(zip(takes, measured, emg, strict=True)):
        write_trial(folder / f"trials/speed{i + 1}", m, moments + noise[i], e / top, take, p.side, full)
    return {
        "emg_scale": dict(zip(anatomy.CHANNEL_NAMES, (peak * top).tolist(), strict=True)),
        "rate_hz": RATE,
    }
