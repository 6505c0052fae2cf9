"""Locks of output folders, and deletion of files that killed runs left."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from wrapjax.cli.command_line import main
from wrapjax.errors import InputError
from wrapjax.io.files import BusyError, lock_folder, new_folder, write_text

#: Program that locks a folder until it is killed.
HOLDER = """
import sys, time
from pathlib import Path
from wrapjax.io.files import new_folder
with new_folder(Path(sys.argv[1]), force=True) as folder:
    (folder / "half").write_text("half")
    print("locked", flush=True)
    time.sleep(600.0)
"""


@pytest.fixture
def other_run(tmp_path):
    """Start another process that writes the folder ``run``."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path / "run")],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "locked\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_second_run_is_refused_while_the_first_one_writes(other_run, tmp_path):
    before = names(tmp_path)
    refused = pytest.raises(
        BusyError, match=rf"run: is being written by another run \(process {other_run.pid} "
    )
    with refused, new_folder(tmp_path / "run", force=True):
        pytest.fail("the work must not start")
    assert names(tmp_path) == before
    with new_folder(tmp_path / "elsewhere"):
        pass


def test_commands_refuse_a_locked_folder_before_reading_input(other_run, tmp_path, capsys):
    before = names(tmp_path)
    for command in (["fit", "nobody"], ["calibrate", "nobody", "--method", "NGA"], ["cohort", "nobody"]):
        assert main([*command, "--out", str(tmp_path / "run"), "--force"]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and "is being written by another run" in error
    assert names(tmp_path) == before


def test_lock_and_files_of_a_killed_run_do_not_remain(other_run, tmp_path):
    other_run.send_signal(signal.SIGKILL)
    other_run.wait()
    assert len(names(tmp_path)) == 2, "a lock and half a folder were expected"
    with new_folder(tmp_path / "run") as folder:
        assert [path.name for path in folder.iterdir()] == []
    assert names(tmp_path) == ["run"]


def test_similar_names_are_not_deleted(tmp_path):
    """Names of temporary folders of another output folder, and names that are not of temporary folders."""
    others = [".run-2-abcdefgh.part", ".run-20240101", ".runs", "run-abcdefgh.part", ".other-abcdefgh.part"]
    for name in others:
        (tmp_path / name).mkdir()
    (tmp_path / ".run-abcdefgh.part").mkdir()
    with new_folder(tmp_path / "run"):
        pass
    assert names(tmp_path) == sorted([*others, "run"])


def test_old_folder_is_restored_if_the_process_was_killed_while_replacing_it(tmp_path):
    """Between the two steps of a replacement neither the old nor the new folder is at the final path."""
    kept = tmp_path / ".run-abcdefgh.old" / "run"
    kept.mkdir(parents=True)
    (kept / "mine").write_text("mine")
    (tmp_path / ".run-hgfedcba.part").mkdir()
    with pytest.raises(InputError, match="exists already"), new_folder(tmp_path / "run"):
        pytest.fail("the work must not start")
    assert names(tmp_path) == ["run"] and (tmp_path / "run" / "mine").read_text() == "mine"


def test_locks_of_one_process_can_be_nested_and_leave_no_files(tmp_path):
    place = tmp_path / "deep" / "er" / "run"
    with lock_folder(place), lock_folder(place):
        assert (place.parent / ".run.lock").read_text().startswith(f"process {os.getpid()} on ")
    assert names(tmp_path) == []
    with pytest.raises(KeyError), lock_folder(place):
        raise KeyError
    assert names(tmp_path) == []


def test_a_link_to_a_folder_has_the_lock_of_the_folder(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with lock_folder(tmp_path / "real" / "run"), lock_folder(tmp_path / "link" / "run"):
        pass
    with lock_folder(Path("/")):
        pass


def test_no_error_where_a_lock_cannot_be_created(tmp_path):
    (tmp_path / "file").write_text("")
    with lock_folder(tmp_path / "file" / "run"):
        pass
    assert names(tmp_path) == ["file"]


def test_temporary_files_of_killed_processes_are_deleted_after_a_day(tmp_path):
    old, new = tmp_path / ".result-abcdefgh.part.json", tmp_path / ".result-hgfedcba.part.json"
    for file in (old, new):
        file.write_text("half")
    os.utime(old, (0.0, 0.0))
    write_text(tmp_path / "result.json", "whole")
    assert names(tmp_path) == sorted([new.name, "result.json"])
    shutil.rmtree(tmp_path)
