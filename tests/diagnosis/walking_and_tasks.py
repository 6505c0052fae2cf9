"""Synthetic subject that walks often enough for a diagnosis, and has trials of other tasks."""

from __future__ import annotations

import dataclasses

import numpy as np

from wrapjax.subject.subject import Subject, load_subject


def load_with_seven_cycles(folder) -> Subject:
    """Load a subject with its cycles repeated, with noise: six for calibration, one for validation."""
    subject = load_subject(folder)
    generator = np.random.default_rng(0)
    gait = np.flatnonzero(subject.trials.is_gait)
    others = np.flatnonzero(~subject.trials.is_gait)
    trials = subject.trials.select(np.concatenate([np.resize(gait, 7), others]))
    count = len(others)
    phase = np.linspace(0.0, 2.0 * np.pi, trials.moments.shape[-1])
    waves = np.stack([np.ones_like(phase), np.sin(phase), np.cos(phase)])
    noise = np.zeros(trials.moments.shape)
    noise[:7] = generator.normal(size=(*noise[:7].shape[:2], 3)) @ waves
    later = np.concatenate([10.0 * np.arange(7), np.zeros(count)])[:, None]
    trials = dataclasses.replace(
        trials,
        names=(*(f"walk/{number:02d}" for number in range(7)), *trials.names[7:]),
        recordings=(*("walk",) * 7, *trials.recordings[7:]),
        uses=(*("calibration",) * 6, "validation", *trials.uses[7:]),
        speeds=np.concatenate([[0.8, 0.8, 0.8, 1.2, 1.2, 1.2, 0.8], np.full(count, np.nan)]),
        time=trials.time + later,
        emg_time=trials.emg_time + later,
        moments=trials.moments + noise,
    )
    walk = dataclasses.replace(subject.recordings[0], name="walk")
    recordings = (walk, *(entry for entry in subject.recordings if entry.task != "gait"))
    rates = (subject.emg_rates[0], *subject.emg_rates[-len(recordings) + 1 :])
    return dataclasses.replace(subject, trials=trials, recordings=recordings, emg_rates=rates)
