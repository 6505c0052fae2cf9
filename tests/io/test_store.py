"""The store of results: what makes a kept result stale, and what does not."""

from pathlib import Path

import numpy as np
import pytest

import wrapjax
from wrapjax.io import store
from wrapjax.io.store import Store, code_hash, fingerprint

#: Sources of a small package: `calibration.solve` uses `model.forward`, which uses `muscle`.
SOURCES = {
    "io/store.py": "A = 1\n",
    "calibration/solve.py": (
        "from wrapjax.model.forward import (\n    predict,\n)\n\n\n"
        "def page():\n    from wrapjax.report.page import write\n"
    ),
    "calibration/__init__.py": "",
    "model/__init__.py": "",
    "model/forward.py": "from wrapjax.muscle import curves\n\n\ndef predict():\n    return curves\n",
    "model/constants.json": "1",
    "muscle/__init__.py": "",
    "muscle/curves.py": "A = 1\n",
    "diagnosis/score.py": "A = 1\n",
    "report/page.py": "from wrapjax.diagnosis import score\n",
    "cli/calibrate.py": "A = 1\n",
}
SOLVE = "wrapjax.calibration.solve"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of these sources in place of this one."""
    assert Path(store.__file__).parents[1] == Path(wrapjax.__file__).parent
    for name, text in SOURCES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(store, "__file__", str(tmp_path / "io" / "store.py"))
    return tmp_path


def hashes(module=""):
    return code_hash.__wrapped__(module)


@pytest.mark.parametrize("file", ["model/forward.py", "muscle/curves.py", "model/constants.json", SOLVE])
def test_a_changed_formula_makes_results_stale(package, file):
    """Also one that is imported by what the module imports."""
    file = "calibration/solve.py" if file == SOLVE else file
    before = hashes(SOLVE), hashes()
    (package / file).write_text((package / file).read_text() + "\n")
    assert hashes(SOLVE) != before[0] and hashes() != before[1]


@pytest.mark.parametrize("file", ["report/page.py", "cli/calibrate.py", "notes.txt"])
def test_changed_words_make_no_result_stale(package, file):
    before = hashes(SOLVE), hashes()
    (package / file).write_text("# says why\n")
    assert (hashes(SOLVE), hashes()) == before


def test_a_module_that_is_not_imported_concerns_other_results_only(package):
    before = hashes(SOLVE), hashes()
    (package / "diagnosis/score.py").write_text("A = 2\n")
    assert hashes(SOLVE) == before[0] and hashes() != before[1]


def test_a_module_that_imports_the_package_depends_on_all_of_it(package):
    (package / "muscle/curves.py").write_text("import wrapjax\n")
    assert hashes(SOLVE) == hashes()


@pytest.mark.parametrize(
    ("module", "used", "not_used"),
    [
        (
            "wrapjax.calibration.calibration",
            ("muscle/hill.py", "calibration/objective.py", "calibration/solvers/levenberg_marquardt.py"),
            ("diagnosis/evidence/score.py", "report/markup.py", "cohorts/cohort.py"),
        ),
        (
            "wrapjax.osim.muscle_analysis",
            ("osim/path_engine.py", "osim/workers.py"),
            ("calibration/objective.py", "geometry/exact_paths/engine.py"),
        ),
        (
            "wrapjax.path_sources.path_fitting",
            ("geometry/surrogates/surrogate.py",),
            ("calibration/objective.py",),
        ),
    ],
)
def test_the_sources_of_a_result_are_found(module, used, not_used):
    """Of this package: what a calibration, an analysis and a fit are calculated with."""
    package = Path(wrapjax.__file__).parent
    assert all((package / name).is_file() for name in (*used, *not_used))
    found = {file.relative_to(package).as_posix() for file in store._imported_by(module, package)}
    assert set(used) <= found
    assert not set(not_used) & found


def test_inputs_and_code_decide_the_fingerprint(package):
    code_hash.cache_clear()
    names = {fingerprint(*inputs, module=module) for inputs in ((1, "a"), (1, "b")) for module in ("", SOLVE)}
    code_hash.cache_clear()
    assert len(names) == 4


def test_arrays_return_bit_for_bit(tmp_path):
    values = {
        "lengths": np.array([0.1, np.nan, np.inf]),
        "names": np.array("soleus"),
        "none": np.zeros((0, 2)),
    }
    own = Store(tmp_path)
    assert own.read_arrays("first") is None
    own.write_arrays("first", **values)
    read = own.read_arrays("first")
    assert set(read) == set(values)
    for name, array in values.items():
        np.testing.assert_array_equal(read[name], array)
    assert own.read_arrays("second") is None


@pytest.mark.parametrize("content", [b"", b"rubbish", None], ids=["empty", "rubbish", "cut"])
def test_damaged_arrays_are_absent(tmp_path, content):
    own = Store(tmp_path)
    own.write_arrays("first", lengths=np.arange(100.0))
    file = tmp_path / "first.npz"
    file.write_bytes(file.read_bytes()[:200] if content is None else content)
    assert own.read_arrays("first") is None


def test_a_damaged_folder_is_absent(tmp_path):
    own = Store(tmp_path)

    def load(folder):
        return int((folder / "number.txt").read_text())

    assert own.read("first", load) is None
    own.place("first").mkdir()
    assert own.read("first", load) is None
    for text, expected in (("7", 7), ("seven", None)):
        (own.place("first") / "number.txt").write_text(text)
        assert own.read("first", load) == expected
