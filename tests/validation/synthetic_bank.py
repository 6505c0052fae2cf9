"""Synthetic bank and answerers with known scores."""

import json
from pathlib import Path

import numpy as np

from validation.blind.anatomy import COORDINATES
from validation.blind.effects import EFFECTS
from validation.blind.seal import seal

FRAMES, RATE = 1300, 100.0
CYCLES = [[[1.0 + i, 2.0 + i] for i in range(7)] for _ in range(3)]
SPEEDS = [0.5, 0.8, 1.0]
NAMES = tuple(EFFECTS)
FLOOR = 1.0


def write_bank(folder: Path, single: int = 64, other: int = 12, people: int = 8) -> list[dict]:
    """Write a bank with sinusoidal clean moments; measured ones differ from them by 1 N m."""
    rng = np.random.default_rng(7)
    truths = []
    tiers = ["single"] * single + ["none"] * other + ["outside"] * other + ["pair"] * other
    for order, tier in enumerate(tiers):
        name = f"{order:012x}"
        effect, second = NAMES[order % len(NAMES)], NAMES[(order + 5) % len(NAMES)]
        causes = {"single": [effect], "none": [], "outside": ["joint_friction"], "pair": [effect, second]}[
            tier
        ]
        truth = {
            "id": name,
            "person": f"p{order % people}",
            "tier": tier,
            "emg_noise": (0.05, 0.1, 0.2)[order % 3],
            "d_star": [1.0, 3.0, 7.0, 9.0][order % 4] if tier != "none" else 0.0,
            "ties": [second] if order % 4 == 1 and tier == "single" else [],
            "causes": [
                {
                    "id": c,
                    "family": EFFECTS[c].family if c in EFFECTS else "outside",
                    "parameters": _parameters(c),
                }
                for c in causes
            ],
            "cycles": CYCLES,
            "calibration_cycles": 5,
            "speeds_m_s": SPEEDS,
            "floor_Nm2": {"held_out_cycles": FLOOR, "held_out_speed": FLOOR},
        }  # fmt: skip
        truths.append(truth)
        time = np.arange(FRAMES) / RATE
        clean = 20.0 * np.sin(2 * np.pi * time + np.arange(6)[:, None]) * np.ones((3, 1, 1))
        (folder / "truth").mkdir(parents=True, exist_ok=True)
        (folder / "truth" / f"{name}.json").write_text(json.dumps(truth))
        np.save(folder / "truth" / f"{name}.npy", clean.astype(np.float32))
        noise = np.where(np.arange(FRAMES) % 2, 1.0, -1.0) + 0.0 * rng.random()
        for recording in range(3):
            place = folder / "cases" / name / "trials" / f"walk_{recording + 1}"
            place.mkdir(parents=True)
            if order % 8 == 2:  # moments of some cases suffice
                columns = {
                    f"{c}_moment": row + noise for c, row in zip(COORDINATES, clean[recording], strict=True)
                }
                write_table(place / "moments.sto", {"time": time, **columns})
    seal(folder)
    return truths


def _parameters(cause: str) -> dict[str, float]:
    effect = EFFECTS.get(cause)
    return effect.parameters(0.3, effect.variants(None)[0]) if effect else {}


def write_table(path: Path, columns: dict[str, np.ndarray]) -> None:
    rows = np.array(list(columns.values())).T
    lines = ["t", "endheader", "\t".join(columns), *("\t".join(f"{v:.5g}" for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def answer(folder: Path, truth: dict, gap: dict) -> None:
    place = folder / truth["id"]
    place.mkdir(parents=True, exist_ok=True)
    (place / "gap.json").write_text(json.dumps(gap))


def gap(outcome: str, probabilities: dict[str, float], **more) -> dict:
    entries = [
        {"id": name, "probability": p, "parameters": more.pop("parameters", [])}
        for name, p in probabilities.items()
    ]
    return {"outcome": outcome, "effects": entries, "named": [], "ties": [], "credible_set": [], **more}


def perfect(truth: dict, withheld: bool = False) -> dict:
    """Answer correctly."""
    causes = [c["id"] for c in truth["causes"]]
    if truth["tier"] == "none":
        return gap("none", {"none": 1.0})
    if truth["tier"] == "outside" or withheld:
        return gap("unknown", {"unknown": 1.0})
    parameters = [{"name": n, "value": v} for n, v in truth["causes"][0]["parameters"].items()]
    share = 1.0 / len(causes)
    return gap(
        "named", dict.fromkeys(causes, share), named=causes, credible_set=causes, parameters=parameters
    )


def guessing(truth: dict, withheld: bool = False) -> dict:
    """Name a random effect with equal probabilities of all."""
    rng = np.random.default_rng(int(truth["id"], 16) + 99)
    drawn = [NAMES[i] for i in rng.permutation(len(NAMES))]
    weights = {name: 1.0 / len(NAMES) + (1e-6 if name == drawn[0] else 0.0) for name in drawn}
    return gap("named", weights, named=drawn[:1], credible_set=drawn[:2])


def tying(truth: dict, withheld: bool = False) -> dict:
    """Answer a tie of all effects."""
    return gap("tie", dict.fromkeys(NAMES, 1.0 / len(NAMES)), ties=[list(NAMES)], credible_set=list(NAMES))


def silent(truth: dict, withheld: bool = False) -> dict:
    return gap("none", {"none": 1.0})


def confident(truth: dict, withheld: bool = False) -> dict:
    """Name the same effect with certainty."""
    return gap("named", {NAMES[0]: 1.0}, named=[NAMES[0]], credible_set=[NAMES[0]])


ANSWERERS = (perfect, guessing, tying, silent, confident)
