"""``[emg.channels]`` and ``[emg.extrapolated]`` of the settings: what excites which muscles."""

from __future__ import annotations

from pathlib import Path

from wrapjax.errors import Problem
from wrapjax.subject.schema import TableReader


def read_channels(table: object, file: Path, problems: list[Problem]) -> dict[str, tuple[str, ...]]:
    """Take the muscles of each channel; a muscle can be driven by one channel only."""
    reader = TableReader(table, file, "[emg.channels]", problems)
    channels = {}
    driven_by: dict[str, str] = {}
    for channel in table if isinstance(table, dict) else ():
        muscles = reader.names(channel)
        if muscles is None:
            continue
        channels[channel] = muscles
        for muscle in muscles:
            if muscle in driven_by:
                message = (
                    f"expected one channel a muscle, found '{muscle}' driven by '{driven_by[muscle]}' already"
                )
                reader.problem(channel, message)
            driven_by.setdefault(muscle, channel)
    if not table and not reader.silent:
        reader.problem("", 'expected at least one channel, such as soleus = ["soleus_l"]')
    return channels


def read_extrapolated(
    table: object, channels: dict[str, tuple[str, ...]], file: Path, problems: list[Problem]
) -> dict[str, tuple[str, ...]] | None:
    """Take the muscles of each excitation that nobody measured; a muscle has one, or a channel."""
    if table is None:
        return None
    reader = TableReader(table, file, "[emg.extrapolated]", problems)
    found = {}
    taken = {muscle: f"channel '{channel}'" for channel, own in channels.items() for muscle in own}
    for name in table if isinstance(table, dict) else ():
        muscles = reader.names(name)
        if muscles is None:
            continue
        found[name] = muscles
        for muscle in muscles:
            if muscle in taken:
                reader.problem(
                    name, f"expected muscles without excitation, found '{muscle}', which has {taken[muscle]}"
                )
            taken.setdefault(muscle, f"'{name}'")
    return found
