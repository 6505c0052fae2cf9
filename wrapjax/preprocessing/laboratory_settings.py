"""The settings of a preparation: one TOML file that names a laboratory's files and says what is in them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from wrapjax.errors import InputError, Problem
from wrapjax.io.toml import TableReader, describe_value, parse_toml, read_toml_text
from wrapjax.preprocessing.force_plates import SIDES, ForceColumns
from wrapjax.subject.settings import TrialSettings, read_channels, read_cycles

#: Volts in each unit of EMG.
VOLTS = {"V": 1.0, "mV": 1e-3, "uV": 1e-6}
_AXES = ("x", "-x", "y", "-y", "z", "-z")


@dataclass(frozen=True)
class RawTrial:
    """One ``[[trial]]`` of a laboratory.

    Parameters
    ----------
    name, use, speed
        As in a subject folder; ``speed`` in m/s, NaN where not given.
    markers, angles
        Where motion comes from: one of the two, None the other.
    forces, emg
        Files.
    cycles
        Start and end of each gait cycle in s; empty: found by the vertical force.
    """

    name: str
    use: str
    speed: float
    markers: Path | None
    angles: Path | None
    forces: Path
    emg: Path
    cycles: tuple[tuple[float, float], ...]

    @property
    def motion(self) -> Path:
        """The file that motion comes from."""
        file = self.markers or self.angles
        assert file is not None
        return file


@dataclass(frozen=True)
class RawSettings:
    """All of the settings.

    Parameters
    ----------
    file, text
        The settings' own file, and what it says.
    name, mass_kg, side, paretic
        The person and the leg.
    model_file, coordinates, muscle_parameters
        The model and what a subject folder says of it.
    scaling
        OpenSim's settings of its scale tool, None where the model is scaled already.
    forward, up
        Axes of the laboratory, for ``.trc`` and ``.c3d`` files.
    ignored_markers, marker_weights
        Markers not to follow, and weights other than 1.
    feet
        Which forces are whose.
    channels
        The muscles that each EMG channel drives.
    emg_kind, volts
        ``raw`` or ``envelope``; volts at the electrode in one unit of raw EMG's files: unit over gain.
    accepted
        Channels used whatever their faults.
    trials
        In the order of the file.
    """

    file: Path
    text: str
    name: str
    mass_kg: float
    side: str
    paretic: bool | None
    model_file: Path
    coordinates: tuple[str, ...]
    muscle_parameters: Path | None
    scaling: Path | None
    forward: str
    up: str
    ignored_markers: tuple[str, ...]
    marker_weights: dict[str, float]
    feet: dict[str, ForceColumns]
    channels: dict[str, tuple[str, ...]]
    emg_kind: str
    volts: float
    accepted: tuple[str, ...]
    trials: tuple[RawTrial, ...]


def read_raw_settings(file: Path) -> RawSettings:
    """Read the settings of a preparation; paths in it start from its folder.

    Raises
    ------
    InputError
        With everything wrong in it.
    """
    file = Path(file)
    problems: list[Problem] = []
    text = read_toml_text(file)
    top = TableReader(parse_toml(text, file), file, "", problems)

    subject = TableReader(top.table("subject"), file, "[subject]", problems)
    name = subject.text("name") or ""
    mass = subject.number("mass_kg", lowest=5.0, highest=400.0, unit="kg")
    side = subject.text("side", choices=("l", "r")) or ""
    paretic = subject.boolean("paretic")
    subject.finish()

    model = TableReader(top.table("model"), file, "[model]", problems)
    model_file = _file(model, "file")
    coordinates = model.names("coordinates") or ()
    muscle_parameters = _file(model, "muscle_parameters", required=False)
    scaling = _file(model, "scaling", required=False)
    model.finish()

    laboratory = TableReader(top.raw("laboratory") or {}, file, "[laboratory]", problems)
    forward = laboratory.text("forward", required=False, choices=_AXES) or "x"
    up = laboratory.text("up", required=False, choices=_AXES) or "y"
    if forward[-1] == up[-1]:
        laboratory.problem("up", f"expected another axis than forward, found '{forward}' and '{up}'")
    laboratory.finish()

    markers = TableReader(top.raw("markers") or {}, file, "[markers]", problems)
    ignored = markers.names("ignore", required=False)
    weights = _weights(markers, problems)
    markers.finish()

    feet = _feet(top, file, side, problems)

    emg = TableReader(top.table("emg"), file, "[emg]", problems)
    kind = emg.text("kind", required=False, choices=("raw", "envelope")) or "raw"
    unit = emg.text("unit", required=kind == "raw", choices=tuple(VOLTS))
    gain = emg.number("gain", lowest=1e-3, highest=1e7, unit="", required=False)
    if kind == "envelope" and (emg.has("unit") or emg.has("gain")):
        emg.problem(
            "", "expected no unit and no gain of envelopes, which are normalised to about 1, found one"
        )
    accepted = emg.names("accept", required=False)
    channels = read_channels(emg.table("channels"), file, problems)
    emg.finish()

    tables = top.tables("trial")
    trials = [_trial(table, number, file, problems) for number, table in enumerate(tables, start=1)]
    top.finish()
    if problems:
        raise InputError(problems)
    assert mass is not None and model_file is not None and (unit is not None or kind == "envelope")
    return RawSettings(
        file=file,
        text=text,
        name=name,
        mass_kg=mass,
        side=side,
        paretic=paretic,
        model_file=model_file,
        coordinates=coordinates,
        muscle_parameters=muscle_parameters,
        scaling=scaling,
        forward=forward,
        up=up,
        ignored_markers=ignored or (),
        marker_weights=weights,
        feet=feet,
        channels=channels,
        emg_kind=kind,
        volts=1.0 if unit is None else VOLTS[unit] / (gain or 1.0),
        accepted=accepted or (),
        trials=tuple(trial for trial in trials if trial is not None),
    )


def _file(reader: TableReader, key: str, *, required: bool = True) -> Path | None:
    """Take a file, which may lie anywhere, and check that it is there."""
    value = reader.text(key, required=required)
    if value is None:
        return None
    path = reader.file.parent / value
    try:
        there = path.is_file()
    except OSError:  # a name that no file can have
        there = False
    if not there:
        reader.problem(key, f"expected a file, found no {path}")
        return None
    return path


def _weights(markers: TableReader, problems: list[Problem]) -> dict[str, float]:
    table = markers.raw("weights")
    if table is None:
        return {}
    reader = TableReader(table, markers.file, "[markers.weights]", problems)
    found = {name: reader.number(name, lowest=1e-6, highest=1e6, unit="") for name in table}
    return {name: weight for name, weight in found.items() if weight is not None}


def _feet(top: TableReader, file: Path, own: str, problems: list[Problem]) -> dict[str, ForceColumns]:
    reader = TableReader(top.table("forces"), file, "[forces]", problems)
    feet = {}
    for side in SIDES:
        if not reader.has(side):
            continue
        foot = TableReader(reader.table(side), file, f"[forces.{side}]", problems)
        body = foot.text("body") or ""
        plates = foot.raw("plates")
        if plates is not None:
            if (
                not isinstance(plates, list)
                or not plates
                or not all(isinstance(n, int) and n > 0 for n in plates)
            ):
                foot.problem("plates", f"expected numbers from 1, found {describe_value(plates)}")
            else:
                feet[side] = ForceColumns(body, plates=tuple(plates))
        else:
            force, point = foot.text("force") or "", foot.text("point") or ""
            feet[side] = ForceColumns(body, force, point, foot.text("torque", required=False) or "")
        foot.finish()
    if own and not reader.has(own) and not reader.silent:
        reader.problem("", f"expected [forces.{own}], what the ground does to the leg's own foot, found none")
    reader.finish()
    return feet


def _trial(table: object, number: int, file: Path, problems: list[Problem]) -> RawTrial | None:
    reader = TableReader(table, file, f"[[trial]] number {number}", problems)
    name = reader.text("name")
    if name is not None and not TrialSettings.is_fit_name(name):
        reader.problem("name", f"expected letters, digits, '_', '-', '+' and '.', found '{name}'")
    use = reader.text("use", choices=("calibration", "validation"))
    speed = reader.number("speed_m_s", lowest=0.0, highest=15.0, unit="m/s", required=False)
    if reader.has("markers") == reader.has("angles"):
        found = "both" if reader.has("markers") else "neither"
        reader.problem("markers", f"expected either markers or angles, found {found}")
    markers, angles = (_file(reader, key, required=False) for key in ("markers", "angles"))
    forces, emg = (_file(reader, key) for key in ("forces", "emg"))
    cycles = read_cycles(reader) if reader.has("cycles") or reader.has("cycle") else ()
    reader.raw("cycle"), reader.raw("cycles")
    reader.finish()
    if name is None or use is None or forces is None or emg is None or (markers is None) == (angles is None):
        return None
    return RawTrial(name, use, math.nan if speed is None else speed, markers, angles, forces, emg, cycles)
