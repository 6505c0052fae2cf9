"""Downloads equal the published files or are refused; failures are reported after retries."""

from pathlib import Path

import numpy as np
import pytest

from tests.cli.folders import names
from wrapjax.datasets.public_recordings import PUBLIC_RECORDINGS, RETRIES, write_public_subject
from wrapjax.errors import InputError
from wrapjax.io.model_file import read_model_file
from wrapjax.io.storage import read_storage
from wrapjax.preprocessing.files.joint_angles import Motion, find_coupled_coordinates, read_motion
from wrapjax.preprocessing.files.markers import low_pass
from wrapjax.subject.external_loads import read_ground_loads
from wrapjax.subject.subject import load_subject


def test_files_are_written_and_cached(server, recording, tmp_path):
    write_public_subject(recording, tmp_path / "first", server=server.address)
    assert names(tmp_path / "first") == [
        "ORIGIN.txt",
        "subject.toml",
        "trials/walk/external_loads.xml",
        "trials/walk/ground_forces.mot",
    ]
    trial = tmp_path / "first" / "trials" / "walk"
    assert (trial / "ground_forces.mot").read_bytes() == b"forces"
    # Names of other files within a file are replaced by the local names.
    assert (trial / "external_loads.xml").read_bytes() == b"<datafile>ground_forces.mot</datafile>"
    origin = (tmp_path / "first" / "ORIGIN.txt").read_text()
    assert "people/repository, commit abc123" in origin and "folder/below; licence Apache-2.0" in origin
    asked = len(server.asked)
    assert asked == 2
    server.files.clear()
    write_public_subject(recording, tmp_path / "second", server=server.address)
    assert len(server.asked) == asked, "what was kept was asked for again"


def test_wrong_checksum_is_refused(server, recording, tmp_path):
    path = f"/{recording.place}/walk.xml"
    server.files[path] = b"something else"
    with pytest.raises(InputError, match=r"walk\.xml: is damaged .* checksum is wrong"):
        write_public_subject(recording, tmp_path / "out", server=server.address)
    assert list(tmp_path.iterdir()) == []
    assert server.asked.count(path) == 1 + RETRIES
    # The wrong file is not cached: it is downloaded again once the server has the right one.
    server.files[path] = b"<datafile>walk.mot</datafile>"
    write_public_subject(recording, tmp_path / "out", server=server.address)


def test_a_failing_request_is_repeated(server, recording, tmp_path):
    path = f"/{recording.place}/walk.mot"
    server.refusals[path] = 2
    write_public_subject(recording, tmp_path / "out", server=server.address)
    assert server.asked.count(path) == 3


def test_server_that_keeps_failing(server, recording, tmp_path):
    server.refusals[f"/{recording.place}/walk.mot"] = 100
    with pytest.raises(InputError, match=r"walk\.mot: cannot be downloaded: .* status 503; try again later"):
        write_public_subject(recording, tmp_path / "out", server=server.address)
    assert list(tmp_path.iterdir()) == []


def test_no_server(recording, tmp_path):
    """No server listens on port 9 of this machine."""
    with pytest.raises(InputError, match=r"cannot be downloaded: no answer .* is this machine online\?"):
        write_public_subject(recording, tmp_path / "out", server="http://127.0.0.1:9")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", PUBLIC_RECORDINGS)
def test_published_files_make_a_subject(name, server, data_folder, tmp_path):
    """The recorded folders were made from these files by hand: names, checksums and settings must agree."""
    recording = PUBLIC_RECORDINGS[name]
    for file in recording.files:
        content = (data_folder / name / file.target).read_bytes()
        for published, ours in file.renamed:
            content = content.replace(ours.encode(), published.encode())
        server.files[f"/{recording.place}/{file.source}"] = content
    write_public_subject(recording, tmp_path / name, server=server.address)
    for file in recording.files:
        assert (tmp_path / name / file.target).read_bytes() == (data_folder / name / file.target).read_bytes()
    ours, theirs = load_subject(tmp_path / name), load_subject(data_folder / name)
    for field in ("name", "mass_kg", "side", "muscles", "muscle_channels", "undriven_muscles"):
        assert repr(getattr(ours, field)) == repr(getattr(theirs, field))
    assert ours.trials.names == theirs.trials.names and ours.trials.uses == theirs.trials.uses
    assert (ours.trials.time == theirs.trials.time).all() and (ours.trials.emg == theirs.trials.emg).all()
    with_loads = [trial for trial in ours.recordings if trial.external_loads is not None]
    assert with_loads == list(ours.recordings)
    for trial in with_loads:
        assert isinstance(trial.ground_forces, Path) and read_ground_loads(trial) is not None


def test_added_external_loads_give_the_published_moments(server, data_folder, tmp_path):
    """The assignment of columns to feet was not published."""
    pytest.importorskip("opensim")
    from wrapjax.osim.model import describe_model
    from wrapjax.osim.tools import solve_inverse_dynamics

    recording = PUBLIC_RECORDINGS["healthy_treadmill"]
    for file in recording.files:
        server.files[f"/{recording.place}/{file.source}"] = (
            data_folder / recording.name / file.target
        ).read_bytes()
    write_public_subject(recording, tmp_path / "walker", server=server.address)
    trial = load_subject(tmp_path / "walker").recordings[0]
    model = tmp_path / "walker" / "model.osim"
    couplers = find_coupled_coordinates(describe_model(model).coordinates)
    infos = read_model_file(model).coordinates
    read = read_motion(trial.angles, infos, couplers, ("knee_angle_l",), [])
    # Filtered as the published moments; the filter has not settled in their first and last frames.
    smooth = Motion(read.coordinates, read.time, low_pass(read.time, read.values, 6.0)).with_coupled(couplers)
    part = (read.time > 2.0) & (read.time < 5.0)
    solved = solve_inverse_dynamics(
        model, smooth.coordinates, read.time[part], smooth.values[:, part], trial.external_loads
    )
    published = read_storage(trial.moments)
    for label in ("knee_angle_l_moment", "ankle_angle_l_moment", "ankle_angle_r_moment"):
        given = np.interp(
            read.time[part], published.time, published.values[:, published.columns.index(label)]
        )
        assert np.sqrt(np.mean((solved[label] - given)[10:-10] ** 2)) < 1.0, label
