"""Atomic writing of files and folders, strict JSON, and content hashes."""

import json
import os
import resource
import stat
from pathlib import Path

import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.io.files import (
    cache_folder,
    content_hash,
    new_folder,
    write_atomically,
    write_json,
    write_text,
)


class Failure(Exception):
    """Any error while writing."""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write_and_fail(path: Path) -> None:
    path.write_text("half")
    raise Failure


def test_failing_writer_leaves_the_old_file(tmp_path):
    file = tmp_path / "result.json"
    write_text(file, "old")
    with pytest.raises(Failure):
        write_atomically(file, write_and_fail)
    assert file.read_text() == "old"
    assert names(tmp_path) == ["result.json"]


def test_failing_writer_leaves_no_file(tmp_path):
    with pytest.raises(Failure):
        write_atomically(tmp_path / "result.json", write_and_fail)
    assert names(tmp_path) == []


@pytest.fixture
def full_disk():
    """Limit files to 1,000 bytes, so that writing fails as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_full_disk_leaves_the_old_file_and_no_partial_file(tmp_path, full_disk):
    file = tmp_path / "result.json"
    write_json(file, {"kept": 1})
    with pytest.raises(OSError) as text_error:
        write_json(file, list(range(1000)))
    with pytest.raises(OSError) as array_error:
        write_atomically(tmp_path / "arrays.npz", lambda path: np.savez(path, a=np.zeros(1000)))
    with pytest.raises(OSError) as folder_error, new_folder(tmp_path / "run") as folder:
        write_text(folder / "small", "small")
        write_json(folder / "large", list(range(1000)))
    # Errors name the final path, not the temporary one.
    found = [error.value.filename for error in (text_error, array_error, folder_error)]
    assert found == [str(file), str(tmp_path / "arrays.npz"), str(tmp_path / "run")]
    assert json.loads(file.read_text()) == {"kept": 1}
    assert names(tmp_path) == ["result.json"]


def test_writing_replaces_files_and_creates_parents(tmp_path):
    file = tmp_path / "deep" / "er" / "result.txt"
    write_text(file, "old")
    write_text(file, "neu: ü")
    assert file.read_bytes() == "neu: ü".encode()
    assert names(file.parent) == ["result.txt"]


def test_readers_see_the_old_file_until_the_new_one_is_complete(tmp_path):
    file = tmp_path / "result.txt"
    write_text(file, "old")

    def write(temporary: Path) -> None:
        temporary.write_text("new")
        assert temporary.parent == file.parent  # on the same file system, so that moving it is atomic
        assert temporary.suffix == ".txt"  # some writers choose the format by the suffix, or append it
        assert file.read_text() == "old"

    write_atomically(file, write)
    assert file.read_text() == "new"


def test_written_files_can_be_read_by_others(tmp_path):
    """Temporary files are readable by the owner only; results must be readable by all."""
    write_text(tmp_path / "result.txt", "text")
    with new_folder(tmp_path / "run"):
        pass
    assert stat.S_IMODE((tmp_path / "result.txt").stat().st_mode) == 0o644
    assert stat.S_IMODE((tmp_path / "run").stat().st_mode) == 0o755


def test_json_is_strict(tmp_path):
    content = {
        "nan": float("nan"),
        "infinite": [np.inf, -np.inf, 1.5],
        "array": np.array([[1.0, np.nan], [3.0, 4.0]]),
        "scalars": (np.float64(0.1), np.int64(3), np.bool_(True), np.float32(np.inf)),
        "path": Path("a") / "b",
        7: None,
    }
    write_json(tmp_path / "result.json", content)

    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    found = json.loads((tmp_path / "result.json").read_text(), parse_constant=refuse)
    assert found == {
        "nan": None,
        "infinite": [None, None, 1.5],
        "array": [[1.0, None], [3.0, 4.0]],
        "scalars": [0.1, 3, True, None],
        "path": str(Path("a") / "b"),
        "7": None,
    }


def test_invalid_json_content_leaves_the_old_file(tmp_path):
    file = tmp_path / "result.json"
    write_json(file, {"kept": 1})
    with pytest.raises(TypeError):
        write_json(file, {"object": object()})
    assert json.loads(file.read_text()) == {"kept": 1}


def test_numbers_keep_all_digits(tmp_path):
    numbers = np.random.default_rng(0).standard_normal(50) * 10.0 ** np.arange(-25, 25)
    write_json(tmp_path / "numbers.json", numbers)
    assert json.loads((tmp_path / "numbers.json").read_text()) == numbers.tolist()


def test_new_folder_appears_when_complete(tmp_path):
    with new_folder(tmp_path / "deep" / "run") as folder:
        (folder / "a").write_text("a")
        assert not (tmp_path / "deep" / "run").exists()
    assert names(tmp_path / "deep") == ["run"]
    assert names(tmp_path / "deep" / "run") == ["a"]


@pytest.mark.parametrize("error", [Failure, KeyboardInterrupt])
def test_new_folder_is_deleted_after_a_failure(tmp_path, error):
    with pytest.raises(error), new_folder(tmp_path / "run") as folder:
        (folder / "a").write_text("a")
        raise error
    assert names(tmp_path) == []


def test_existing_folder_is_refused_before_the_work(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "old").write_text("old")
    refused = pytest.raises(InputError, match="exists already and is not overwritten; use --force")
    with refused, new_folder(tmp_path / "run"):
        pytest.fail("the work must not start")
    assert (tmp_path / "run" / "old").read_text() == "old"


def test_force_replaces_the_folder(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "old").write_text("old")
    with new_folder(tmp_path / "run", force=True) as folder:
        (folder / "new").write_text("new")
        assert names(tmp_path / "run") == ["old"]
    assert names(tmp_path) == ["run"]
    assert names(tmp_path / "run") == ["new"]


def test_force_keeps_the_old_folder_after_a_failure(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "old").write_text("old")
    with pytest.raises(Failure), new_folder(tmp_path / "run", force=True) as folder:
        (folder / "new").write_text("new")
        raise Failure
    assert names(tmp_path) == ["run"]
    assert names(tmp_path / "run") == ["old"]


def test_force_does_not_replace_a_file_by_a_folder(tmp_path):
    (tmp_path / "run").write_text("a file")
    refused = pytest.raises(InputError, match="is a file, where a folder was expected")
    with refused, new_folder(tmp_path / "run", force=True):
        pytest.fail("the work must not start")
    assert (tmp_path / "run").read_text() == "a file"


def test_folder_below_a_file_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be created"), new_folder(tmp_path / "file" / "run"):
        pytest.fail("the work must not start")


def test_folder_in_a_read_only_parent_is_an_input_error(tmp_path, monkeypatch):
    """The error of the operating system is simulated, as an administrator may write everywhere."""

    def refuse(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    refused = pytest.raises(InputError, match=r"run: cannot be created \(Permission denied\)")
    with refused, new_folder(tmp_path / "run"):
        pytest.fail("the work must not start")


ARRAY = np.arange(6.0)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ([ARRAY], [ARRAY.reshape(2, 3)]),
        ([ARRAY.reshape(2, 3)], [ARRAY.reshape(3, 2)]),
        ([ARRAY], [ARRAY.astype(np.float32)]),
        ([np.zeros(4, np.int64)], [np.zeros(4, np.float64)]),
        ([np.zeros(4, np.float32)], [np.zeros(2, np.float64)]),
        ([ARRAY], [ARRAY[::-1]]),
        ([ARRAY], [np.nextafter(ARRAY, 9.0)]),
        # The same bytes in another memory order are another matrix.
        ([ARRAY.reshape(2, 3)], [ARRAY.reshape(2, 3, order="F")]),
        (["a", "b"], ["b", "a"]),
        (["ab", "c"], ["a", "bc"]),
        (["ab"], ["a", "b"]),
        ([1], [1.0]),
        ([1], ["1"]),
        ([0.1], [np.nextafter(0.1, 1.0).item()]),
        ([], [""]),
    ],
)
def test_different_content_has_different_hashes(first, second):
    assert content_hash(*first) != content_hash(*second)


def test_same_content_has_the_same_hash():
    strided = np.repeat(ARRAY, 2)[::2]
    assert not strided.flags["C_CONTIGUOUS"]
    assert content_hash(strided, "a", 1) == content_hash(ARRAY.copy(), "a", 1)


def test_a_path_is_hashed_by_the_content_of_its_file(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    first.write_bytes(b"same")
    second.write_bytes(b"same")
    assert content_hash(first) == content_hash(second)
    second.write_bytes(b"else")
    assert content_hash(first) != content_hash(second)


def test_cache_folder_follows_environment_variables(tmp_path, monkeypatch):
    monkeypatch.setenv("WRAPJAX_CACHE", str(tmp_path / "own"))
    assert cache_folder("fit") == tmp_path / "own" / "fit"
    assert os.path.isdir(tmp_path / "own" / "fit")
    monkeypatch.delenv("WRAPJAX_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder("fit") == tmp_path / "xdg" / "wrapjax" / "fit"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder("fit") == tmp_path / "home" / ".cache" / "wrapjax" / "fit"
