"""Simulation of one case: apply its causes to a person, record with noise, and write case and truth."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind.anatomy import COORDINATES, Leg
from validation.blind.background import Background, with_background
from validation.blind.effects import EFFECTS
from validation.blind.effects.effect import Effect
from validation.blind.folder import FILE_STEP, write_folder
from validation.blind.library import SHARE, Library, imitations, likeness, ties
from validation.blind.noise import moment_noise, noisy_envelopes
from validation.blind.oracle import Oracle, cycles, difference, flat, signal
from validation.blind.outside_catalogue import OUTSIDE
from validation.blind.person import Person
from validation.blind.plan import Bank, PlannedCase, stratum_of
from validation.blind.world import Recording, World, joint_moments, record

ALL = {**EFFECTS, **OUTSIDE}


def make_case(
    bank: Bank,
    planned: PlannedCase,
    who: Person,
    library: Library,
    oracles: dict[float, Oracle],
    folder: Path,
    background: Background | None = None,
) -> None:
    """Write ``cases/<id>``, ``truth/<id>.json`` and ``truth/<id>.npy`` in a folder, each atomically."""
    oracle = oracles[planned.level]
    world, causes = who.world, []
    for (name, variant), sign, target in zip(planned.causes, planned.signs, planned.targets, strict=True):
        effect = ALL[name]
        reach = _reach(library, who.world, planned, name, variant)
        amount, reached = find_amount(who.world, oracle, effect, variant, sign, target, reach)
        world = effect.apply(world, amount, variant)
        causes.append(
            {
                "id": name,
                "family": effect.family,
                "variant": list(variant),
                "amount": _six_digits(amount),
                "unit": effect.unit,
                "d_star": _six_digits(reached),
                "parameters": {
                    key: _six_digits(value) for key, value in effect.parameters(amount, variant).items()
                },
            }
        )
    rng = np.random.default_rng((bank.seed, 3, planned.order))
    found = _detectability_and_ties(who.world, world, planned, library, oracle)
    world = with_background(world, background)
    clean, noise, emg = record_with_noise(world, planned.level, rng)
    truth: dict[str, Any] = {
        "schema": 1,
        "id": planned.id,
        "bank": bank.name,
        "person": who.name,
        "world": who.world.settings.name,
        "tier": planned.tier,
        "emg_noise": planned.level,
        "causes": causes,
        **found,
        **({} if background is None else {"background": _described(who.world, background, library, oracle)}),
        "floor_Nm2": _noise_floors(world, emg, noise),
        "speeds_m_s": list(who.world.walk.speeds),
        "calibration_cycles": who.world.settings.gait.calibration,
        "cycles": cycles(who.world),
        "rms_Nm": _rms(clean.moments),
        # Without a nonce the truth could be guessed from its hash.
        "nonce": rng.bytes(16).hex(),
    }
    recorded = {"moments": clean.moments + noise, "emg": emg, "pose": clean.pose, "ground": clean.ground}
    _write(folder, planned.id, who, recorded, truth, clean.moments)


def _rms(moments: np.ndarray) -> dict[str, float]:
    return dict(zip(COORDINATES, map(_six_digits, np.sqrt((moments**2).mean(axis=(0, 2)))), strict=True))


def _reach(
    library: Library, world: World, planned: PlannedCase, name: str, variant: tuple[str, ...]
) -> float | None:
    if name not in EFFECTS:
        return None
    level = world.settings.emg.levels.index(planned.level)
    return float(library.reach[level, library.entries.index((name, variant))])


def find_amount(
    world: World,
    oracle: Oracle,
    effect: Effect,
    variant: tuple[str, ...],
    sign: int,
    target: float,
    reach: float | None,
) -> tuple[float, float]:
    """Find the amount whose d* is near the target, up to the largest plausible one; return it and its d*."""

    def detectability(amount: float) -> float:
        values = flat(world, difference(world, effect, amount, variant)[1])
        return float(np.sqrt(max(values @ oracle.whiten(values), 0.0)))

    amount = _three_digits(
        sign * effect.most * (SHARE if reach is None else min(1.0, target / max(reach, 1e-9)))
    )
    reached = detectability(amount)
    for _ in range(4):
        if 0.88 < reached / target < 1.12 or (reached < target and abs(amount) >= effect.most):
            break
        # Signals are nearly proportional to the amount; steps are limited to a factor of four.
        factor = np.clip(target / max(reached, 1e-6), 0.25, 4.0)
        amount = _three_digits(np.clip(amount * factor, -effect.most, effect.most))
        reached = detectability(amount)
    return amount, reached


def _detectability_and_ties(
    base: World, world: World, planned: PlannedCase, library: Library, oracle: Oracle
) -> dict[str, Any]:
    if not planned.causes:
        return {"d_star": 0.0, "ties": [], "like": None}
    first, variant = planned.causes[0]
    reference = ALL[first].apply(base, 0.0, variant) if first == "bound_pressure" else base
    values = flat(base, signal(world, reference))
    strength = float(values @ oracle.whiten(values))
    residuals = imitations(library, oracle, first, values)
    name, cosine = likeness(residuals, strength)
    tied = ties(residuals) if planned.tier == "single" else []
    return {
        "d_star": _six_digits(np.sqrt(strength)),
        "stratum": stratum_of(np.sqrt(strength)),
        "ties": tied,
        "like": {"id": name, "cosine": _six_digits(cosine)},
    }


def _described(world: World, background: Background, library: Library, oracle: Oracle) -> dict[str, Any]:
    """Describe a background: its d*, the effect most similar to it, and its moments."""
    values = flat(world, signal(with_background(world, background), world))
    strength = float(values @ oracle.whiten(values))
    name, cosine = likeness(imitations(library, oracle, "", values), strength)
    return {
        "d_star": _six_digits(np.sqrt(strength)),
        "like": {"id": name, "cosine": _six_digits(cosine)},
        "rms_Nm": _rms(background.moments),
    }


def record_with_noise(
    world: World, level: float, rng: np.random.Generator
) -> tuple[Recording, np.ndarray, np.ndarray]:
    """Record a world; return the recording without noise, the noise of moments, and the noisy envelopes."""
    clean, settings = record(world), world.settings
    noise = moment_noise(world.walk, world.leg.mass, rng, settings.moments)
    return clean, noise, noisy_envelopes(clean.emg, level, rng, settings.emg)


def _noise_floors(world: World, emg: np.ndarray, noise: np.ndarray) -> dict[str, float]:
    """Compute the mean squared error (N m)^2 of a perfect model with noisy EMG on each held-out set."""
    # Add the recorded EMG noise to the true drive of the same world, so that only noise remains.
    driven = replace(world, drive=np.maximum(world.drive + emg - record(world).emg, 0.0))
    error = (noise + joint_moments(world) - joint_moments(driven)) ** 2
    time = world.walk.time
    used, calibration = cycles(world), world.settings.gait.calibration

    def mean(sets: list[tuple[int, tuple[float, float]]]) -> float:
        parts = [error[r][:, (time >= a) & (time <= b)].mean() for r, (a, b) in sets]
        return _six_digits(np.mean(parts))

    last = len(used) - 1
    return {
        "held_out_cycles": mean([(r, pair) for r in range(last) for pair in used[r][calibration:]]),
        "held_out_speed": mean([(last, pair) for pair in used[last]]),
    }


def _three_digits(amount: float) -> float:
    # Last bits of the amount differ between machines and would change every file.
    return float(f"{float(amount):.3g}")


def _six_digits(value: float) -> float:
    """Round to six significant digits, which are the same on every machine."""
    return float(f"{float(value):.6g}")


def write_recorded(folder: Path, who: Person, leg: Leg, recorded: dict[str, np.ndarray]) -> None:
    """Write a new subject folder with a person's recording and this leg as its model file."""
    settings = who.world.settings
    write_folder(
        folder,
        leg,
        who.paretic,
        who.world.walk.speeds,
        cycles(who.world),
        recorded,
        settings.gait.calibration,
        settings.emg.unrecorded,
    )


def _write(folder: Path, name: str, who: Person, recorded, truth, clean: np.ndarray) -> None:
    cases, answers, work = folder / "cases", folder / "truth", folder / "work" / name
    shutil.rmtree(work, ignore_errors=True)
    write_recorded(work / name, who, who.nominal, recorded)
    answers.mkdir(parents=True, exist_ok=True)
    cases.mkdir(parents=True, exist_ok=True)
    np.save(work / "clean.npy", np.round(clean[..., ::FILE_STEP], 3).astype(np.float32))
    text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
    (work / "truth.json").write_text(text, encoding="utf-8", newline="\n")
    (work / "clean.npy").replace(answers / f"{name}.npy")
    (work / "truth.json").replace(answers / f"{name}.json")
    shutil.rmtree(cases / name, ignore_errors=True)
    (work / name).rename(cases / name)
    shutil.rmtree(work)
