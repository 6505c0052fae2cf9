"""Known errors added to recordings of people, in addition to their real noise and model error.

Nothing of `wrapjax.diagnosis` is used, so that the diagnosis does not identify its own formulas. Which errors
are possible depends on the recording: several speeds, ground forces with external loads, channels over
neighboring muscles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, filtfilt

from validation.recorded.recordings import Recording, read_recordings, settings_of, write_changed
from wrapjax.errors import InputError, Problem
from wrapjax.io.storage import Storage

#: Magnitudes in prior standard deviations of the effects.
MAGNITUDES = (0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Manipulation:
    """Recording with an added error.

    Parameters
    ----------
    name
        Name of its folder.
    says
        Description of the change.
    change
        Function that changes all recordings, in their order.
    effect
        Effect of the catalogue that should be found; None if there is none.
    hidden
        EMG channel that is removed; empty for none.
    mass_factors
        Factor on the mass of bodies of the model, by name of the body.
    """

    name: str
    says: str
    change: Callable[[Sequence[Recording]], list[Recording]]
    effect: str | None
    hidden: str = ""
    mass_factors: Mapping[str, float] = field(default_factory=dict)


def write_manipulation(source: Path, folder: Path, manipulation: Manipulation) -> None:
    """Write a copy of a subject folder with an added error; raises `InputError` as `write_changed`."""
    changed = manipulation.change(read_recordings(source))
    write_changed(source, folder, changed, manipulation.mass_factors, manipulation.hidden)


# ---- EMG


def column(table: Storage, name: str) -> int:
    """Return the index of a column."""
    return table.columns.index(name)


def with_delay(recordings: Sequence[Recording], seconds: float) -> list[Recording]:
    """Delay all EMG by half the value at the slowest speed, and advance it by half at the fastest."""
    slow, fast = min(c.speed for c in recordings), max(c.speed for c in recordings)

    def shifted(recording: Recording) -> Recording:
        lag = seconds * (0.5 - (recording.speed - slow) / (fast - slow))
        time, values = recording.emg.time, recording.emg.values
        moved = np.stack([np.interp(time - lag, time, own) for own in values.T], axis=1)
        return replace(recording, emg=replace(recording.emg, values=moved))

    return [shifted(recording) for recording in recordings]


def with_drift(recordings: Sequence[Recording], channel: str, change: float) -> list[Recording]:
    """Multiply a channel by a ramp over the session with mean one and a given change from first to last."""

    def scaled(one: Recording) -> Recording:
        gain = 1.0 + change * (one.order_at(one.emg.time) - 0.5)
        return _channels(one, {channel: lambda own: own * gain})

    return [scaled(one) for one in recordings]


def with_crosstalk(recordings: Sequence[Recording], source: str, into: str, share: float) -> list[Recording]:
    """Add a share of one channel to another."""

    def mixed(one: Recording) -> Recording:
        added = share * one.emg.values[:, column(one.emg, source)]
        return _channels(one, {into: lambda own: own + added})

    return [mixed(one) for one in recordings]


def with_offset(
    recordings: Sequence[Recording], channel: str, offset: float, slowest_only: bool
) -> list[Recording]:
    """Add a constant to a channel, in all recordings or in those of the slowest speed."""
    return _in_some(recordings, slowest_only, lambda one: _channels(one, {channel: lambda own: own + offset}))


def with_gain(recordings: Sequence[Recording], channel: str, gain: float) -> list[Recording]:
    """Multiply a channel at the slowest speed."""
    return _in_some(recordings, True, lambda one: _channels(one, {channel: lambda own: gain * own}))


def with_lost_channel(recordings: Sequence[Recording], channel: str) -> list[Recording]:
    """Set a channel to zero at the slowest speed."""
    return with_gain(recordings, channel, 0.0)


def with_exchanged(recordings: Sequence[Recording], first: str, second: str) -> list[Recording]:
    """Exchange two channels."""

    def exchanged(one: Recording) -> Recording:
        own = {name: one.emg.values[:, column(one.emg, name)] for name in (first, second)}
        return _channels(one, {first: lambda _: own[second], second: lambda _: own[first]})

    return [exchanged(one) for one in recordings]


def _channels(recording: Recording, changes: Mapping[str, Callable[[np.ndarray], np.ndarray]]) -> Recording:
    values = recording.emg.values.copy()
    for channel, change in changes.items():
        place = column(recording.emg, channel)
        values[:, place] = change(recording.emg.values[:, place])
    return replace(recording, emg=replace(recording.emg, values=values))


def _in_some(
    recordings: Sequence[Recording], slowest_only: bool, change: Callable[[Recording], Recording]
) -> list[Recording]:
    slowest = min(one.speed for one in recordings)
    return [change(one) if not slowest_only or one.speed == slowest else one for one in recordings]


# ---- Moments, motion and forces


def with_spring(recordings: Sequence[Recording], coordinate: str, stiffness: float) -> list[Recording]:
    """Add the moment of a spring (stiffness in N m/deg, zero at angle zero) to the measured moment."""

    def sprung(one: Recording) -> Recording:
        angle = _degrees(one)[:, column(one.angles, coordinate)]
        values = one.moments.values.copy()
        values[:, column(one.moments, f"{coordinate}_moment")] -= stiffness * np.interp(
            one.moments.time, one.angles.time, angle
        )
        return replace(one, moments=replace(one.moments, values=values))

    return [sprung(one) for one in recordings]


def with_wrong_mass(recordings: Sequence[Recording], ratio: float) -> list[Recording]:
    """Scale moments, as if they were normalized by body mass and multiplied by a wrong one."""
    return [
        replace(one, moments=replace(one.moments, values=ratio * one.moments.values)) for one in recordings
    ]


def with_skin_slide(recordings: Sequence[Recording], coordinate: str, degrees: float) -> list[Recording]:
    """Add a share of the angle's deviation from its mean, which is ``degrees`` where it is largest."""

    def slid(one: Recording) -> Recording:
        place = column(one.angles, coordinate)
        angle = one.angles.values[:, place]
        deviation = angle - angle.mean()
        unit = degrees if one.angles.in_degrees else np.deg2rad(degrees)
        values = one.angles.values.copy()
        values[:, place] += unit * deviation / np.abs(deviation).max()
        return replace(one, angles=replace(one.angles, values=values))

    return [slid(one) for one in recordings]


def with_moved_pressure(recordings: Sequence[Recording], meters: float) -> list[Recording]:
    """Move the centers of pressure forward, along the first horizontal axis of the ground."""

    def moved(one: Recording) -> Recording:
        assert one.forces is not None
        values = one.forces.values.copy()
        for place, name in enumerate(one.forces.columns):
            if name.endswith("_px"):
                values[:, place] += meters
        return replace(one, forces=replace(one.forces, values=values))

    return [moved(one) for one in recordings]


def with_late_forces(recordings: Sequence[Recording], seconds: float) -> list[Recording]:
    """Record forces later than motion."""

    def late(one: Recording) -> Recording:
        assert one.forces is not None
        time = one.forces.time
        values = np.stack([np.interp(time - seconds, time, own) for own in one.forces.values.T], axis=1)
        return replace(one, forces=replace(one.forces, values=values))

    return [late(one) for one in recordings]


def with_filter(recordings: Sequence[Recording], kind: str, hertz: float) -> list[Recording]:
    """Filter one kind of signal again (zero-phase, low-pass), and leave the others unchanged."""

    def smoothed(one: Recording) -> Recording:
        table: Storage = getattr(one, kind)
        rate = (table.time.size - 1) / (table.time[-1] - table.time[0])
        values = filtfilt(*butter(2, hertz, fs=rate), table.values, axis=0)
        filtered = np.maximum(values, 0.0) if kind == "emg" else values
        changed: dict[str, Any] = {kind: replace(table, values=filtered)}
        return replace(one, **changed)

    return [smoothed(one) for one in recordings]


def _degrees(one: Recording) -> np.ndarray:
    return one.angles.values if one.angles.in_degrees else np.rad2deg(one.angles.values)


# ---- What is possible in whom


def manipulations_of(folder: Path, magnitudes: Sequence[float] = MAGNITUDES) -> list[Manipulation]:
    """List the errors that can be added to the recordings of a subject folder.

    Parameters
    ----------
    folder
        Valid subject folder.
    magnitudes
        Sizes in prior standard deviations of the effects (20 ms, 30 %, 0.15, 0.02, 1.5 N m/deg, 10 mm, 10 ms,
        15 %, 3.4 degrees); exchanged, lost and hidden channels have one size.

    Raises
    ------
    InputError
        If no channel drives the soleus.
    """
    settings, recordings = settings_of(folder), read_recordings(folder)
    side = settings["subject"]["side"]
    channels = settings["emg"]["channels"]
    soleus = _channel_of(channels, "soleus")
    if soleus is None:
        raise InputError(Problem(str(folder), "no channel drives the soleus"))
    neighbor = _channel_of(channels, "tib_ant", "tibant") or _channel_of(channels, "gasmed", "med_gas")
    other = _channel_of(channels, "vas_lat", "vaslat") or neighbor
    speeds = {one.speed for one in recordings if np.isfinite(one.speed)}
    several = len(speeds) > 1
    ankle = f"ankle_angle_{side}"
    found: list[Manipulation] = []

    def add(name: str, says: str, change: Callable[..., list[Recording]], effect: str) -> None:
        found.append(Manipulation(name, says, change, effect))

    for size in magnitudes:
        end = f"{size:g}"
        if several:
            lag = 0.020 * size
            says = f"EMG {1000 * lag:g} ms later at the slowest speed than at the fastest"
            add(f"delay_{end}", says, partial(with_delay, seconds=lag), "speed_dependent_delay")
            gain = 1.0 + 0.30 * size
            says = f"gain of {soleus} {gain:g} at the slowest speed"
            add(f"gain_{end}", says, partial(with_gain, channel=soleus, gain=gain), "emg_drift")
        drift = 0.30 * size
        says = f"gain of {soleus} {100 * drift:g} % up from the first cycle to the last"
        add(f"drift_{end}", says, partial(with_drift, channel=soleus, change=drift), "emg_drift")
        offset = 0.02 * size
        says = f"{offset:g} added to {soleus}" + (" at the slowest speed" if several else "")
        raised = partial(with_offset, channel=soleus, offset=offset, slowest_only=several)
        add(f"offset_{end}", says, raised, "emg_offset")
        if neighbor is not None:
            share = 0.15 * size
            says = f"{100 * share:g} % of {soleus} recorded by {neighbor}"
            mixed = partial(with_crosstalk, source=soleus, into=neighbor, share=share)
            add(f"crosstalk_{end}", says, mixed, "emg_crosstalk")
        stiffness = 1.5 * size
        says = f"spring of {stiffness:g} N m/deg at the ankle"
        sprung = partial(with_spring, coordinate=ankle, stiffness=stiffness)
        add(f"spring_{end}", says, sprung, "ankle_foot_orthosis")
        slide = 3.4 * size
        says = f"ankle angle wrong by up to {slide:g} degrees"
        slid = partial(with_skin_slide, coordinate=ankle, degrees=slide)
        add(f"skin_{end}", says, slid, "soft_tissue_artifact")
        if all(one.has_loads for one in recordings):
            says = f"center of pressure {10 * size:g} mm further forward"
            add(f"pressure_{end}", says, partial(with_moved_pressure, meters=0.010 * size), "cop_offset")
            says = f"forces {10 * size:g} ms later than motion"
            add(f"late_forces_{end}", says, partial(with_late_forces, seconds=0.010 * size), "force_latency")
            factors = dict.fromkeys((f"femur_{side}", f"tibia_{side}"), 1.0 + 0.15 * size)
            says = f"thigh and shank {15 * size:g} % heavier"
            found.append(Manipulation(f"mass_{end}", says, list, "segment_inertia", mass_factors=factors))
    if other is not None:
        exchanged = partial(with_exchanged, first=soleus, second=other)
        add("exchanged", f"{soleus} and {other} exchanged", exchanged, "emg_channel_swap")
        found.append(Manipulation("hidden", f"no electrode {other}", list, "missing_drive", hidden=other))
    if several:
        lost = partial(with_lost_channel, channel=soleus)
        add("lost", f"{soleus} lost at the slowest speed", lost, "emg_channel_loss")
    return found


def knock_outs() -> list[Manipulation]:
    """List typical laboratory mistakes and missing electrodes."""
    return [
        *(
            Manipulation(f"without_{name}", f"no electrode {name}", list, "missing_drive", hidden=name)
            for name in ("TibPost", "GlutMed")
        ),
        Manipulation(
            "wrong_mass",
            "moments scaled by a mass 15 % too large",
            partial(with_wrong_mass, ratio=1.15),
            None,
        ),
        Manipulation(
            "smooth_moments",
            "moments filtered once more, at 3 Hz",
            partial(with_filter, kind="moments", hertz=3.0),
            None,
        ),
        Manipulation(
            "smooth_emg", "EMG filtered once more, at 3 Hz", partial(with_filter, kind="emg", hertz=3.0), None
        ),
    ]


def _channel_of(channels: Mapping[str, Sequence[str]], *stems: str) -> str | None:
    """Find the channel that drives a muscle whose name begins with one of these stems."""
    return next(
        (
            channel
            for channel, muscles in channels.items()
            if any(name.startswith(stem) for name in muscles for stem in stems)
        ),
        None,
    )
