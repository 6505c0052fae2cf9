"""What in a subject's recordings may spoil a calibration or a diagnosis, each finding in one sentence.

Channels are compared with themselves: a cycle, or a window of another task, with the others of the person. A
finding is a question to whoever recorded, not a fault of the folder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import welch

from wrapjax.io.storage import Storage, component_name, find_columns, read_storage
from wrapjax.preprocessing.checks.consistency_checks import check_calf_emg_against_moment
from wrapjax.subject.emg_envelopes import compute_envelopes, resample_evenly, sampling_rate
from wrapjax.subject.gait_activity import exchanged_channels
from wrapjax.subject.subject import Subject
from wrapjax.subject.trial_settings import TrialSettings
from wrapjax.subject.trials import GAIT, MOVEMENT, PASSIVE, Trials

#: Robust standard deviations, and share of the channel's peak, by which a floor must exceed the median floor.
FLOOR_DEVIATIONS, FLOOR_SHARE = 5.0, 0.04
#: Share of the median amplitude below which a channel has lost its signal.
LOST_SHARE = 0.2
#: Two channels are swapped where they are further than this from their usual patterns, in robust standard
#: deviations over cycles, and less than this share as far if exchanged.
SWAP_DEVIATION, SWAP_RATIO = 3.0, 0.6
#: Consecutive cycles in which similar channels are compared.
PERSISTENT = 5
#: Smallest standard deviation of a channel over cycles, as a share of its peak.
SMALLEST_SPREAD = 0.02
#: Fewest cycles of a person, and fewest consecutive ones with a finding, unless they are a whole recording.
FEWEST, CONSECUTIVE = 5, 2
#: Runs of equal samples at a channel's maximum: fewest samples of a run, and fewest runs.
CLIPPED_SAMPLES, CLIPPED_RUNS = 4, 3
#: Power near a mains frequency over that of its neighbourhood, and share of the power above 20 Hz.
MAINS_RATIO, MAINS_SHARE = 15.0, 0.05
#: Root mean square of pelvis residuals: share of body weight for forces, and of body weight times 1 m for
#: moments. Published guidance is stricter for simulations (Hicks et al. 2015, doi:10.1115/1.4029304).
RESIDUAL_FORCE, RESIDUAL_MOMENT = 0.10, 0.10
#: Prefixes of the names of calf muscles.
_CALF = ("soleus", "gas", "med_gas", "lat_gas")
_NORMAL = 1.4826


@dataclass(frozen=True)
class Finding:
    """One finding in the recordings.

    Parameters
    ----------
    kind
        ``baseline``, ``lost channel``, ``swapped channels``, ``saturation``, ``mains``, ``timing`` or
        ``pelvis residual``.
    recording
        Name of the recording.
    subjects
        Channels or columns that it concerns.
    sentence
        The finding with its figures.
    cycles
        Names of the cycles or windows that it concerns; empty where it concerns the whole recording.
    """

    kind: str
    recording: str
    subjects: tuple[str, ...]
    sentence: str
    cycles: tuple[str, ...] = ()


def recording_findings(subject: Subject) -> tuple[Finding, ...]:
    """Look for what may spoil a calibration or a diagnosis in the recordings of a subject.

    Returns
    -------
    tuple of Finding
        Findings in the order of their kinds; empty if there are none.
    """
    trials = subject.trials
    recorded = np.array([entry.emg is not None for entry in subject.recordings])
    names = [entry.name for entry, has in zip(subject.recordings, recorded, strict=True) if has]
    with_emg = trials.select(np.array([name in names for name in trials.recordings], dtype=bool))
    found: list[Finding] = []
    if len(with_emg):
        found += [*_baselines(with_emg), *_lost_channels(with_emg), *_swapped_channels(with_emg)]
        found += _exchanged_channels(with_emg, subject)
    for recording in subject.recordings:
        emg = None if recording.emg is None else read_storage(recording.emg)
        moments = read_storage(recording.moments)
        if emg is not None:
            found += [*_saturated(recording, emg, subject), *_mains(recording, emg, subject)]
            found += _timing(recording, emg, moments, subject)
        found += _pelvis_residuals(recording, moments, subject)
    order = tuple(dict.fromkeys(entry.kind for entry in found))
    return tuple(sorted(found, key=lambda entry: order.index(entry.kind)))


def _inside(trials: Trials) -> Float[np.ndarray, "trial channel frame"]:
    """Return the EMG of the frames of every cycle or window."""
    return trials.emg[..., trials.inside]


def _runs_of_cycles(trials: Trials, flagged: Bool[np.ndarray, " trial"]) -> Iterator[tuple[str, list[int]]]:
    """Group flagged cycles by recording; few that do not follow each other are left out."""
    names = np.array(trials.recordings)
    for name in dict.fromkeys(trials.recordings):
        own = np.flatnonzero(names == name)
        marks = flagged[own]
        edges = np.flatnonzero(np.diff(np.concatenate([[False], marks, [False]]).astype(int)))
        kept = [
            int(own[place])
            for first, after in edges.reshape(-1, 2)
            if after - first >= CONSECUTIVE or marks.all()
            for place in range(first, after)
        ]
        if kept:
            yield name, kept


def _named(trials: Trials, rows: Sequence[int]) -> tuple[str, ...]:
    return tuple(trials.names[row] for row in rows)


def _where(trials: Trials, rows: Sequence[int]) -> str:
    """Say in which cycles, and when, a finding is."""
    name = trials.recordings[rows[0]]
    total = sum(one == name for one in trials.recordings)
    noun = "cycles" if trials.tasks[rows[0]] == GAIT else "windows"
    start, end = trials.time[rows[0], 0], trials.time[rows[-1], -1]
    return f"{len(rows)} of {total} {noun} of '{name}' ({start:.4g} to {end:.4g} s)"


def _baselines(trials: Trials) -> Iterator[Finding]:
    """Find cycles whose quiet level is above that of the channel's other cycles.

    In movements other than gait, such as squats, muscles that hold the body need never rest.
    """
    trials = trials.select(np.array([task != MOVEMENT for task in trials.tasks], dtype=bool))
    if len(trials) < 2:
        return
    emg = _inside(trials)
    floors, peaks = np.percentile(emg, 2.0, axis=2), emg.max(axis=(0, 2))
    names = np.array(trials.recordings)
    for name in dict.fromkeys(names[[task not in (GAIT, PASSIVE) for task in trials.tasks]].tolist()):
        # A window of a held contraction has no quiet level of its own; its recording has one.
        floors[names == name] = floors[names == name].min(axis=0)
    several = np.array([np.sum(names == name) > 1 for name in names])
    for row, channel in enumerate(trials.channels):
        own = floors[:, row]
        by_recording = np.array([np.median(own[names == name]) for name in names])
        each = np.array([np.median(own[names == name]) for name in dict.fromkeys(names.tolist())])
        # Of two recordings the lower is the usual one.
        usual = float(each.min() if each.size == 2 else np.median(each))
        # The only cycle of a recording is its own median, and tells nothing of the spread within one.
        deviations = (own - by_recording)[several] if several.any() else own - usual
        spread = _NORMAL * float(np.median(np.abs(deviations)))
        limit = usual + max(FLOOR_DEVIATIONS * spread, FLOOR_SHARE * float(peaks[row]))
        for name, rows in _runs_of_cycles(trials, own > limit):
            level = float(np.median(own[rows]))
            sentence = (
                f"EMG channel '{channel}' never falls below {level:.3g} in {_where(trials, rows)}, where it "
                f"falls to {usual:.3g} in the others: subtract the baseline, or look for a loose electrode"
            )
            yield Finding("baseline", name, (channel,), sentence, _named(trials, rows))


def _lost_channels(trials: Trials) -> Iterator[Finding]:
    """Find gait cycles in which a channel has lost its signal."""
    gait = trials.only_gait()
    if len(gait) < FEWEST:
        return
    amplitude = np.ptp(_inside(gait), axis=2)
    for row, channel in enumerate(gait.channels):
        usual = float(np.median(amplitude[:, row]))
        for name, rows in _runs_of_cycles(gait, amplitude[:, row] < LOST_SHARE * usual):
            sentence = (
                f"EMG channel '{channel}' varies by {np.median(amplitude[rows, row]):.3g} in "
                f"{_where(gait, rows)}, in the median cycle by {usual:.3g}: it lost its signal there"
            )
            yield Finding("lost channel", name, (channel,), sentence, _named(gait, rows))


def _swapped_channels(trials: Trials) -> Iterator[Finding]:
    """Find gait cycles in which two channels have each other's usual patterns."""
    gait = trials.only_gait()
    if len(gait) < FEWEST:
        return
    emg = _inside(gait)
    usual = np.median(emg, axis=0)
    spread = _NORMAL * np.median(np.abs(emg - usual), axis=0)
    spread = np.maximum(spread, SMALLEST_SPREAD * usual.max(axis=1, keepdims=True) + 1e-12)
    # Mean squared deviation of each channel from the usual pattern of each, in that one's spread.
    deviation = np.square((emg[:, :, None] - usual[None, None]) / spread[None, None]).mean(axis=-1)
    deviation = np.sqrt(deviation)
    count = len(gait.channels)
    found: list[tuple[float, list[int], Finding]] = []
    for first in range(count):
        for second in range(first + 1, count):
            kept = np.hypot(deviation[:, first, first], deviation[:, second, second])
            swapped = np.hypot(deviation[:, first, second], deviation[:, second, first])
            flagged = (kept > SWAP_DEVIATION) & (swapped < SWAP_RATIO * kept)
            flagged |= _persistent(swapped / kept, gait)
            for name, rows in _runs_of_cycles(gait, flagged):
                pair = (gait.channels[first], gait.channels[second])
                sentence = (
                    f"EMG channels '{pair[0]}' and '{pair[1]}' look swapped in {_where(gait, rows)}: they "
                    f"are {np.median(kept[rows]):.3g} standard deviations from their usual patterns, and "
                    f"{np.median(swapped[rows]):.3g} if exchanged"
                )
                ratio = float(np.median(swapped[rows] / kept[rows]))
                finding = Finding("swapped channels", name, pair, sentence, _named(gait, rows))
                found.append((ratio, rows, finding))
    # A channel that carries another's signal is far from its own pattern, so that it seems swapped with a
    # third one, too: in the same cycles the best exchange counts.
    explained: set[tuple[int, str]] = set()
    for _, rows, finding in sorted(found, key=lambda one: one[0]):
        concerned = {(row, channel) for row in rows for channel in finding.subjects}
        if not concerned & explained:
            explained |= concerned
            yield finding


def _exchanged_channels(trials: Trials, subject: Subject) -> Iterator[Finding]:
    """Find channels that have each other's usual phases of activity in all gait cycles."""
    gait = trials.only_gait()
    if not len(gait):
        return
    typical = dict(zip(gait.channels, np.median(_inside(gait), axis=0), strict=True))
    muscles: dict[str, list[str]] = {}
    for muscle, channel in subject.channel_of.items():
        muscles.setdefault(channel, []).append(muscle)
    driving = {name: typical[name] for name in gait.channels if name in muscles}
    for pair, gain in exchanged_channels(driving, muscles).items():
        sentence = (
            f"EMG channels '{pair[0]}' and '{pair[1]}' look swapped in all cycles: they fit each other's "
            f"usual phases of activity in walking better than their own ({gain:.2g} gained in correlation)"
        )
        yield Finding("swapped channels", gait.recordings[0], pair, sentence, gait.names)


def _persistent(ratio: Float[np.ndarray, " trial"], trials: Trials) -> Bool[np.ndarray, " trial"]:
    """Mark cycles among `PERSISTENT` consecutive ones of a recording whose median ratio is low."""
    flagged = np.zeros(ratio.size, dtype=bool)
    names = np.array(trials.recordings)
    for name in dict.fromkeys(trials.recordings):
        own = np.flatnonzero(names == name)
        for first in range(own.size - PERSISTENT + 1):
            rows = own[first : first + PERSISTENT]
            if np.median(ratio[rows]) < SWAP_RATIO and np.max(ratio[rows]) < 0.9:
                flagged[rows] = True
    return flagged


def _columns_of(table: Storage, subject: Subject) -> Iterator[tuple[str, Float[np.ndarray, " sample"]]]:
    for channel in subject.trials.channels:
        places = find_columns(table.columns, channel)
        if len(places) == 1:
            yield channel, table.values[:, places[0]]


def _saturated(recording: TrialSettings, emg: Storage, subject: Subject) -> Iterator[Finding]:
    """Find channels that stay at their extreme."""
    for channel, signal in _columns_of(emg, subject):
        for extreme in dict.fromkeys((float(signal.max()), float(signal.min()))):
            # A quiet envelope may stay at zero.
            if abs(extreme) < 0.5 * np.abs(signal).max():
                continue
            on = np.concatenate([[False], signal == extreme, [False]]).astype(int)
            lengths = np.flatnonzero(np.diff(on) < 0) - np.flatnonzero(np.diff(on) > 0)
            long = lengths[lengths >= CLIPPED_SAMPLES]
            if long.size >= CLIPPED_RUNS and np.ptp(signal) > 0.0:
                sentence = (
                    f"EMG channel '{channel}' of '{recording.name}' is saturated: it stays at {extreme:.3g} "
                    f"for up to {long.max()} samples, {long.size} times"
                )
                yield Finding("saturation", recording.name, (channel,), sentence)


def _mains(recording: TrialSettings, emg: Storage, subject: Subject) -> Iterator[Finding]:
    """Find power at 50 or 60 Hz that stands out from its neighbourhood."""
    rate = sampling_rate(emg.time)
    if rate < 150.0 or emg.time.size < 4 * rate:
        return
    for channel, signal in _columns_of(emg, subject):
        frequency, power = welch(signal, rate, nperseg=round(2.0 * rate))
        above = power[frequency > 20.0].sum()
        for mains in (50.0, 60.0):
            near = np.abs(frequency - mains) <= 1.0
            around = (np.abs(frequency - mains) > 2.0) & (np.abs(frequency - mains) < 8.0)
            ratio = float(power[near].max() / max(float(np.median(power[around])), 1e-300))
            share = float(power[near].sum() / max(float(above), 1e-300))
            if ratio > MAINS_RATIO and share > MAINS_SHARE:
                sentence = (
                    f"EMG channel '{channel}' of '{recording.name}' has {100.0 * share:.0f} % of its power "
                    f"above 20 Hz at {mains:.0f} Hz, {ratio:.0f} times its neighbourhood: mains residue"
                )
                yield Finding("mains", recording.name, (channel,), sentence)


def _timing(recording: TrialSettings, emg: Storage, moments: Storage, subject: Subject) -> Iterator[Finding]:
    """Find calf channels that are out of step with the ankle moment of gait."""
    ankle = find_columns(moments.columns, f"ankle_angle_{subject.side}", ("_moment", "_force", ""))
    if recording.task != GAIT or len(ankle) != 1:
        return
    start, end = recording.cycles[0][0], recording.cycles[-1][1]
    inside = (moments.time >= start) & (moments.time <= end)
    plantarflexion = -moments.values[inside, ankle[0]]
    period = float(np.median([last - first for first, last in recording.cycles]))
    for channel, signal in _columns_of(emg, subject):
        muscles = [name for name, own in subject.channel_of.items() if own == channel]
        if not any(name.startswith(_CALF) for name in muscles):
            continue
        time, envelope = resample_evenly(emg.time, signal[None])
        rate = (time.size - 1) / (time[-1] - time[0])
        if signal.min() < -0.1 * signal.max():
            envelope = compute_envelopes(envelope, rate, period)
        check = check_calf_emg_against_moment(
            moments.time[inside], plantarflexion, channel, time, envelope[0]
        )
        if check.fault:
            sentence = f"EMG channel '{channel}' of '{recording.name}' is out of step: {check.found}"
            yield Finding("timing", recording.name, (channel,), sentence)


def _pelvis_residuals(recording: TrialSettings, moments: Storage, subject: Subject) -> Iterator[Finding]:
    """Find residual forces and moments at the pelvis that inverse dynamics left, where forces are known."""
    if recording.ground_forces is None:
        return
    inside = np.zeros(moments.time.size, dtype=bool)
    for start, end in recording.cycles:
        inside |= (moments.time >= start) & (moments.time <= end)
    weight = 9.81 * subject.mass_kg
    for column, label in enumerate(moments.columns):
        name = component_name(label)
        if not name.startswith("pelvis_"):
            continue
        force = name.endswith("_force")
        size = float(np.sqrt(np.mean(moments.values[inside, column] ** 2)))
        limit = weight * (RESIDUAL_FORCE if force else RESIDUAL_MOMENT)
        if size > limit:
            unit, expected = (
                ("N", "10 % of body weight") if force else ("N m", "10 % of body weight times 1 m")
            )
            sentence = (
                f"residual '{name}' of '{recording.name}' is {size:.3g} {unit} (root mean square) over its "
                f"cycles, more than {expected}, {limit:.3g} {unit}: motion, forces and masses disagree"
            )
            yield Finding("pelvis residual", recording.name, (name,), sentence)
