"""Error messages for invalid subject folders name the file, the place and, if known, a correction."""

import contextlib
from dataclasses import replace
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from tests.subject.synthetic import MODEL, SETTINGS, write_subject
from wrapjax.errors import InputError
from wrapjax.io.storage import read_storage, write_storage
from wrapjax.subject.subject import load_subject

A = "trials/walk_a"


def swap(file: str, old: str, new: str):
    """Replace text that must be present in a file of the folder."""

    def change(folder: Path) -> None:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new))

    return change


def settings(old: str, new: str):
    return swap("subject.toml", old, new)


def write(file: str, content: str | bytes):
    def change(folder: Path) -> None:
        (folder / file).write_bytes(content if isinstance(content, bytes) else content.encode())

    return change


def remove(file: str):
    return lambda folder: (folder / file).unlink()


def table(file: str, change_table):
    """Modify a table of the folder."""

    def change(folder: Path) -> None:
        write_storage(folder / file, change_table(read_storage(folder / file)))

    return change


def values(file: str, function, column: int | slice = slice(None)):
    """Modify values of a table of the folder."""

    def change_table(storage):
        changed = storage.values.copy()
        changed[:, column] = function(changed[:, column])
        return replace(storage, values=changed)

    return table(file, change_table)


def frames(file: str, keep):
    """Keep some frames of a table of the folder."""
    return table(file, lambda s: replace(s, time=s.time[keep(s.time)], values=s.values[keep(s.time)]))


def cut(file: str, share: float):
    """Truncate a file, as an interrupted copy does."""

    def change(folder: Path) -> None:
        content = (folder / file).read_bytes()
        (folder / file).write_bytes(content[: int(len(content) * share)])

    return change


def parameters(content: str):
    """Add a table of muscle parameters."""

    def change(folder: Path) -> None:
        settings("[model]", '[model]\nmuscle_parameters = "muscles.csv"')(folder)
        (folder / "muscles.csv").write_text(content)

    return change


def both(*changes):
    def change(folder: Path) -> None:
        for one in changes:
            one(folder)

    return change


CSV = """muscle,max_isometric_force_N,optimal_fiber_length_m,tendon_slack_length_m,pennation_rad
recfem_l,1500,0.1,0.3,0.1
semiten_l,900,0.15,0.25,0.1
"""
RAW = settings('kind = "envelope"', 'kind = "raw"')

BROKEN = {
    # The settings
    "no settings": (remove("subject.toml"), ["subject.toml", "does not exist"]),
    "settings not toml": (settings('name = "synthetic"', "name = synthetic"), ["not valid TOML", "line 2"]),
    "settings binary": (write("subject.toml", b"\xff\xfe\x00\x01" * 20), ["subject.toml", "UTF-8"]),
    "settings empty": (
        write("subject.toml", ""),
        ["subject.toml: is empty, where a TOML file of settings was expected"],
    ),
    "settings without tables": (
        write("subject.toml", "# nothing"),
        ["subject: expected", "model: expected", "emg: expected", "[[trial]]", "found nothing"],
    ),
    "unknown key": (settings("mass_kg", "mass_gk"), ["mass_gk", "not a known key", "did you mean 'mass_kg'"]),
    "unknown table": (settings("[subject]", "[subjcet]"), ["subjcet", "did you mean 'subject'"]),
    "unknown key in a trial": (
        settings("speed_m_s", "speed"),
        ["'walk_a' speed", "did you mean 'speed_m_s'"],
    ),
    "missing table": (settings("[emg.channels]", ""), ["[emg] channels", "a table", "nothing"]),
    "missing key": (settings('side = "l"', ""), ["[subject] side", "'l' or 'r'", "nothing"]),
    "wrong side": (settings('side = "l"', 'side = "left"'), ["side", "'l' or 'r'", "'left'"]),
    "mass is text": (settings("70.0", '"heavy"'), ["mass_kg", "a number", "'heavy'"]),
    "mass in grams": (settings("70.0", "70000.0"), ["mass_kg", "kg", "70000"]),
    "paretic is text": (settings('side = "l"', 'side = "l"\nparetic = "yes"'), ["paretic", "true or false"]),
    "no other leg": (settings('side = "l"', 'side = "l"\nother_leg = "../right"'), ["other_leg", "right"]),
    "unknown kind of EMG": (settings('"envelope"', '"enveloppe"'), ["kind", "did you mean 'envelope'"]),
    "unknown use": (settings('"calibration"', '"calibrate"'), ["use", "did you mean 'calibration'"]),
    "trial name twice": (settings('"walk_b"', '"walk_a"'), ["walk_a", "unique name"]),
    "trial name with a slash": (settings('"walk_b"', '"walk/b"'), ["name", "letters", "walk/b"]),
    "speed negative": (settings("speed_m_s = 1.1", "speed_m_s = -1.1"), ["speed_m_s", "-1.1"]),
    "trial not a table": (settings("[[trial]]", "[trial]"), ["not valid TOML"]),
    "channel without muscles": (settings('["recfem_l"]', "[]"), ["[emg.channels] RecFem", "list of names"]),
    "channel is text": (settings('["recfem_l"]', '"recfem_l"'), ["RecFem", "list of names", "'recfem_l'"]),
    # Paths
    "path climbs out": (
        settings('"model.osim"', '"../model.osim"'),
        ["[model] file", "inside", "../model.osim"],
    ),
    "path absolute": (settings(f'"{A}/emg.sto"', '"/etc/passwd"'), ["'walk_a' emg", "inside", "/etc/passwd"]),
    "path of a drive": (settings(f'"{A}/emg.sto"', r'"C:\\emg.sto"'), ["'walk_a' emg", "inside"]),
    # Cycles
    "no cycle": (settings("cycle = [0.6, 1.8]", ""), ["'walk_b' cycle", "neither"]),
    "cycle and cycles": (
        settings("cycle = [0.6", "cycles = [[0.6, 1.8]]\ncycle = [0.6"),
        ["'walk_b'", "both"],
    ),
    "cycle backwards": (
        settings("[0.6, 1.8]", "[1.8, 0.6]"),
        ["'walk_b' cycle", "t0 before t1", "[1.8, 0.6]"],
    ),
    "cycle of three": (settings("[0.6, 1.8]", "[0.6, 1.8, 2.0]"), ["'walk_b' cycle", "[t0, t1]"]),
    "cycle is text": (settings("[0.6, 1.8]", '["a", "b"]'), ["'walk_b' cycle", "[t0, t1]"]),
    "cycle outside": (settings("[1.7, 2.9]", "[2.9, 4.1]"), ["angles.sto", "'walk_a', cycle 2", "0 to 4 s"]),
    "EMG ends before the cycle": (
        frames(f"{A}/emg.sto", lambda time: time < 2.0),
        ["walk_a/emg.sto", "cycle 2 [1.7, 2.9]", "0 to 1.99 s"],
    ),
    "gap in a cycle": (
        frames(f"{A}/moments.sto", lambda time: (time < 2.0) | (time > 2.2)),
        ["moments.sto", "cycle 2", "0.22 s after 1.99 s"],
    ),
    # The model
    "no model": (remove("model.osim"), ["model.osim", "does not exist"]),
    "model cut off": (cut("model.osim", 0.5), ["model.osim", "not well-formed"]),
    "model not xml": (write("model.osim", "hello"), ["model.osim", "not well-formed"]),
    "unknown coordinate": (
        settings('"knee_angle_l"]', '"knee_angel_l"]'),
        ["[model] coordinates", "knee_angel_l", "did you mean 'knee_angle_l'"],
    ),
    "coordinate of the other leg": (
        both(
            settings('"knee_angle_l"]', '"knee_angle_r"]'), swap("model.osim", "knee_angle_l", "knee_angle_r")
        ),
        ["coordinates", "side 'l'", "knee_angle_r"],
    ),
    "coordinate slides": (
        swap("model.osim", "PinJoint", "SliderJoint"),
        ["coordinates", "knee_angle_l", "translational"],
    ),
    "coordinate twice": (settings('"knee_angle_l"]', '"hip_flexion_l"]'), ["coordinates", "more than once"]),
    "unknown muscle": (
        settings('["recfem_l"]', '["recfme_l"]'),
        ["[emg.channels] RecFem", "recfme_l", "did you mean 'recfem_l'"],
    ),
    "muscle in two channels": (
        settings('["semiten_l"]', '["semiten_l", "recfem_l"]'),
        ["[emg.channels] SemiTen", "one channel for each muscle", "'recfem_l'", "'RecFem'"],
    ),
    "muscle of the other leg": (
        both(settings('["recfem_l"]', '["recfem_r"]'), swap("model.osim", "recfem_l", "recfem_r")),
        ["RecFem", "side 'l'", "recfem_r"],
    ),
    "impossible muscle": (
        swap("model.osim", ">0.15<", ">150<"),
        ["semiten_l", "optimal_fiber_length", "150"],
    ),
    # Muscle parameters
    "no parameters": (
        settings("[model]", '[model]\nmuscle_parameters = "muscles.csv"'),
        ["muscles.csv", "does not exist"],
    ),
    "parameters empty": (parameters(""), ["muscles.csv", "empty"]),
    "parameters without a column": (
        parameters(CSV.replace("pennation_rad", "pennation_deg")),
        ["muscles.csv", "pennation_rad", "did you mean 'pennation_deg'"],
    ),
    "parameter negative": (
        parameters(CSV.replace("0.25", "-0.25")),
        ["semiten_l", "tendon_slack_length", "-0.25"],
    ),
    "parameter is text": (
        parameters(CSV.replace("900", "many")),
        ["line 3", "max_isometric_force_N", "'many'"],
    ),
    "pennation in degrees": (
        parameters(CSV.replace("0.3,0.1", "0.3,5.7")),
        ["recfem_l", "pennation_angle", "5.7"],
    ),
    "parameters of a muscle without a channel": (
        both(settings('RecFem = ["recfem_l"]\n', ""), parameters(CSV.replace("0.3,0.1", "nan,0.1"))),
        ["muscles.csv", "recfem_l", "tendon_slack_length", "nan"],
    ),
    "parameters of a muscle missing": (
        parameters(CSV.split("semiten")[0]),
        ["muscles.csv", "semiten_l", "none"],
    ),
    "parameters of an unknown muscle": (
        parameters(CSV + "soleus_l,1,0.1,0.1,0\n"),
        ["muscles.csv", "soleus_l", "not in the model"],
    ),
    "parameters of a muscle twice": (
        parameters(CSV + CSV.splitlines()[1]),
        ["line 4", "recfem_l", "second time"],
    ),
    "parameters cut off": (parameters(CSV[:-14]), ["muscles.csv", "line 3", "expected 5 cells, found 3"]),
    # Tables
    "no angles": (remove(f"{A}/angles.sto"), ["walk_a/angles.sto", "does not exist"]),
    "no ground forces": (
        settings("speed_m_s", 'ground_forces = "grf.mot"\nspeed_m_s'),
        ["grf.mot", "does not exist"],
    ),
    "external loads not xml": (
        both(settings("speed_m_s", 'external_loads = "e.xml"\nspeed_m_s'), write("e.xml", "x")),
        ["e.xml", "XML"],
    ),
    "angles empty": (write(f"{A}/angles.sto", ""), ["walk_a/angles.sto", "empty"]),
    "moments binary": (write(f"{A}/moments.sto", bytes(range(256))), ["walk_a/moments.sto", "binary"]),
    "EMG cut off": (cut(f"{A}/emg.sto", 0.6), ["walk_a/emg.sto", "states 401 rows", "truncated"]),
    "NaN in angles": (
        values(f"{A}/angles.sto", lambda v: np.where(np.arange(v.size) == 50, np.nan, v), 1),
        ["walk_a/angles.sto", "line 58", "column knee_angle_l", "finite", "nan"],
    ),
    "time backwards": (
        swap(f"{A}/moments.sto", "\n1.5\t", "\n1.4\t"),
        ["moments.sto", "time to increase", "1.4"],
    ),
    "no angle column": (
        swap(f"{A}/angles.sto", "knee_angle_l", "knee_angle_r"),
        ["walk_a/angles.sto", "column knee_angle_l", "did you mean 'knee_angle_r'"],
    ),
    "no moment column": (
        swap(f"{A}/moments.sto", "knee_angle_l_moment", "knee_l_moment"),
        ["walk_a/moments.sto", "column knee_angle_l_moment", "did you mean 'knee_l_moment'"],
    ),
    "no channel column": (
        swap(f"{A}/emg.sto", "RecFem", "RectusFem"),
        ["walk_a/emg.sto", "column RecFem", "did you mean 'RectusFem'"],
    ),
    "angle column twice": (
        swap(f"{A}/angles.sto", "hip_flexion_l", "/jointset/knee_l/knee_angle_l/value"),
        ["angles.sto", "column knee_angle_l", "found several"],
    ),
    # Units
    "degrees taken for radians": (
        values(f"{A}/angles.sto", np.rad2deg),
        ["walk_a/angles.sto", "knee_angle_l", "full turn", "inDegrees=yes"],
    ),
    "radians taken for degrees": (
        swap(f"{A}/angles.sto", "inDegrees=no", "inDegrees=yes"),
        ["walk_a/angles.sto", "looks like radians", "inDegrees=no"],
    ),
    "moments zero": (
        values(f"{A}/moments.sto", lambda v: 0.0 * v, 1),
        ["walk_a/moments.sto", "knee_angle_l_moment", "zero throughout"],
    ),
    "moments in N mm": (
        values(f"{A}/moments.sto", lambda v: 1e3 * v),
        ["moments.sto", "expected N m", "N mm"],
    ),
    "moments by mass": (
        values(f"{A}/moments.sto", lambda v: v / 70.0),
        ["moments.sto", "divided by body mass"],
    ),
    "raw EMG taken for envelopes": (
        values(f"{A}/emg.sto", lambda v: np.random.default_rng(1).standard_normal(v.shape)),
        ["emg.sto", "column RecFem", "expected an envelope", 'kind = "raw"'],
    ),
    "envelopes taken for raw EMG": (RAW, ["emg.sto", "raw EMG", "found 100 Hz", 'kind = "envelope"']),
    "envelopes in percent": (values(f"{A}/emg.sto", lambda v: 100.0 * v), ["emg.sto", "normalised", "90"]),
    "EMG constant": (values(f"{A}/emg.sto", lambda v: 0.0 * v), ["emg.sto", "every channel constant"]),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_folder_is_reported(name, tmp_path):
    break_it, words = BROKEN[name]
    folder = write_subject(tmp_path / "subject")
    break_it(folder)
    with pytest.raises(InputError) as caught:
        load_subject(folder)
    message = str(caught.value)
    assert [word for word in words if word not in message] == [], message
    assert str(folder) in message


def test_the_folder_is_valid_when_nothing_is_broken(tmp_path):
    assert len(load_subject(write_subject(tmp_path)).trials) == 3


def test_one_fault_is_reported_once(tmp_path):
    """Trials share files; a broken file must not be reported once per trial."""
    folder = write_subject(tmp_path)
    settings("trials/walk_b/", "trials/walk_a/")(folder)
    cut("trials/walk_a/emg.sto", 0.6)(folder)
    with pytest.raises(InputError) as caught:
        load_subject(folder)
    assert len(caught.value.problems) == 2  # the last row and the number of rows


def test_five_faults_are_reported_at_once(tmp_path):
    folder = write_subject(tmp_path)
    both(
        settings("70.0", "-1.0"),
        settings('["recfem_l"]', '["recfme_l"]'),
        settings("[0.6, 1.8]", "[3.6, 4.8]"),
        remove("trials/walk_a/moments.sto"),
        swap("trials/walk_b/angles.sto", "inDegrees=no", "inDegrees=yes"),
    )(folder)
    with pytest.raises(InputError) as caught:
        load_subject(folder)
    problems = [str(problem) for problem in caught.value.problems]
    for words in (
        ("mass_kg", "-1.0"),
        ("recfme_l", "did you mean 'recfem_l'"),
        ("[3.6, 4.8]", "outside the recording"),
        ("walk_a/moments.sto", "does not exist"),
        ("walk_b/angles.sto", "looks like radians"),
    ):
        assert any(all(word in problem for word in words) for problem in problems), words


def test_no_folder(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        load_subject(tmp_path / "nobody")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file, where a folder was expected"):
        load_subject(tmp_path / "file")


def test_silent_raw_channel(tmp_path):
    """A channel without a signal in any cycle cannot be normalised."""
    folder = write_subject(tmp_path)
    RAW(folder)
    for trial in ("walk_a", "walk_b"):
        path = folder / "trials" / trial / "emg.sto"
        time = np.arange(4001) / 1000.0
        noise = np.random.default_rng(2).standard_normal((time.size, 2)) * [1.0, 0.0]
        write_storage(path, replace(read_storage(path), time=time, values=noise))
    with pytest.raises(InputError) as caught:
        load_subject(folder)
    assert "column SemiTen" in str(caught.value) and "found none in any cycle" in str(caught.value)


REPEATABLE = hypothesis.settings(
    deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
TEXTS = st.sampled_from(["", "l", "../x", "emg", "raw"])
TOML_VALUES = st.recursive(
    st.one_of(st.booleans(), st.integers(-10, 10), st.floats(), TEXTS),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=4,
)


def as_toml(value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)


@hypothesis.settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(line=st.integers(0, len(SETTINGS.splitlines()) - 1), value=TOML_VALUES)
def test_any_value_of_any_key_is_read_or_an_input_error(line, value, tmp_path):
    folder = write_subject(tmp_path)
    lines = SETTINGS.splitlines()
    lines[line] = f"{lines[line].split(' = ')[0]} = {as_toml(value)}"
    (folder / "subject.toml").write_text("\n".join(lines))
    with contextlib.suppress(InputError):
        assert np.isfinite(load_subject(folder).trials.angles).all()


@hypothesis.settings(
    max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(place=st.integers(0, len(MODEL)), length=st.integers(1, 200), rubbish=st.binary(max_size=5))
def test_any_damage_to_the_model_is_read_or_an_input_error(place, length, rubbish, tmp_path):
    folder = write_subject(tmp_path)
    content = MODEL.encode()
    (folder / "model.osim").write_bytes(content[:place] + rubbish + content[place + length :])
    with contextlib.suppress(InputError):
        load_subject(folder)
