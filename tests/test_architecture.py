"""Imports go one way, importing is light, and the project's files would work on anybody's machine."""

import ast
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "wrapjax"

#: What each folder (or module beside the folders) may import of ours.
ARROWS: dict[str, set[str]] = {
    "errors": set(),
    "progress": set(),
    "precision": set(),
    "files": {"errors", "locks"},
    "locks": {"errors"},
    "jax_setup": {"files"},
    "scheduling": {"errors", "jax_setup"},
    "safe_xml": {"errors"},
    "stored": set(),
    "subject": {"errors", "files", "progress", "safe_xml"},
    "nmsm": {"errors", "files", "subject"},
    "raw": {"errors", "files", "skeleton", "subject"},
    "public": {"errors", "files", "progress"},
    "skeleton": {"errors"},
    "osim": {"errors", "files", "progress", "safe_xml", "skeleton", "stored"},
    "geometry": {"errors", "skeleton"},
    "muscle": set(),
    "model": {"geometry", "muscle"},
    "calibrate": {"errors", "files", "stored", "model", "geometry", "muscle"},
    "gap": {"errors", "calibrate", "model", "geometry", "muscle"},
    "measurement": {"errors", "subject", "osim", "gap"},
    "contact": {"errors", "geometry", "skeleton"},
    "evaluate": set(),
    "virtual": {"errors", "files", "stored", "precision", "subject", "osim", "geometry", "muscle", "model"},
    "report": {
        *("errors", "files", "stored", "subject", "nmsm", "geometry", "muscle", "model"),
        *("calibrate", "gap", "contact", "evaluate"),
        "virtual",  # whose truth is drawn beside what calibration found
    },
    "api": {
        *(
            "errors",
            "files",
            "locks",
            "stored",
            "precision",
            "progress",
            "subject",
            "nmsm",
            "raw",
            "skeleton",
            "osim",
        ),
        *("geometry", "muscle", "model", "calibrate", "gap"),
        *("measurement", "contact", "evaluate", "report", "virtual"),
        *("public", "jax_setup", "scheduling"),
    },
    # The commands call the API. Of the rest they need only the solver's options and what 'check' prints.
    "commands": {"api", "errors", "files", "jax_setup", "progress", "subject", "calibrate"},
    "cli": {"commands", "errors", "jax_setup", "locks", "__init__"},
    "__init__": {"api", "errors"},
    "__main__": {"cli"},
}

#: Arrows that may only be followed inside a function: their targets are slow to import.
LAZY_ARROWS = {
    *(("api", "report"), ("commands", "api"), ("commands", "subject"), ("commands", "calibrate")),
}

#: Packages of others that only these folders may import, inside functions.
LAZY_PACKAGES: dict[str, set[str]] = {
    "opensim": {"osim"},
    "ezc3d": {"raw"},
    "matplotlib": {"report"},
    "rich": {"progress"},
    "pandas": set(),
    "pooch": {"public"},
    "requests": {"public"},
    "dask": {"scheduling"},
    "distributed": {"scheduling"},
    "dask_jobqueue": {"scheduling"},
    "sklearn": {"geometry"},
    "xarray": {"api"},
}

#: Folders that must do without JAX, so that a folder can be checked before it is loaded.
WITHOUT_JAX = {
    "errors",
    "files",
    "locks",
    "progress",
    "safe_xml",
    "stored",
    "subject",
    "raw",
    "public",
    "skeleton",
    "osim",
    "evaluate",
    "commands",
    "cli",
    "__init__",
    "__main__",
}
JAX_PACKAGES = {"jax", "jaxlib", "equinox", "optimistix", "lineax", "jaxopt"}


@dataclass(frozen=True)
class Import:
    """One import statement of the package."""

    place: str
    folder: str
    target: str
    lazy: bool


def _folder(parts: tuple[str, ...]) -> str:
    return parts[0].removesuffix(".py")


def imports_of(file: Path) -> list[Import]:
    """Find all imports of a module, except those that only type checkers follow."""
    found = []

    def visit(node: ast.AST, lazy: bool) -> None:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            return
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file.name}:{node.lineno}: imports are absolute in this package"
            # 'from wrapjax import files' names a module of ours, not an attribute.
            names = [node.module or ""]
            if node.module == "wrapjax":
                modules = {_folder((path.name,)) for path in PACKAGE.iterdir()}
                names = [
                    f"wrapjax.{alias.name if alias.name in modules else '__init__'}" for alias in node.names
                ]
        place = f"{file.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}"
        folder = _folder(file.relative_to(PACKAGE).parts)
        found.extend(Import(place, folder, name, lazy) for name in names)
        lazy = lazy or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
        for child in ast.iter_child_nodes(node):
            visit(child, lazy)

    visit(ast.parse(file.read_text(encoding="utf-8")), False)
    return found


@pytest.fixture(scope="module")
def imports() -> list[Import]:
    return [entry for file in sorted(PACKAGE.rglob("*.py")) for entry in imports_of(file)]


@pytest.fixture(scope="module")
def own_imports(imports) -> list[tuple[Import, str]]:
    """Imports between folders of ours, each with the folder that it points to."""
    pairs = [
        (entry, (entry.target.split(".") + ["__init__"])[1])
        for entry in imports
        if entry.target.split(".")[0] == "wrapjax"
    ]
    return [(entry, target) for entry, target in pairs if target != entry.folder]


def test_every_folder_has_a_row_in_the_table(imports):
    folders = {_folder(file.relative_to(PACKAGE).parts) for file in PACKAGE.rglob("*.py")}
    assert sorted(folders - set(ARROWS)) == []


def test_arrows_go_one_way(own_imports):
    wrong = [f"{entry.place}: {entry.target}" for entry, to in own_imports if to not in ARROWS[entry.folder]]
    assert wrong == []


def test_slow_folders_of_ours_are_imported_late(own_imports):
    wrong = [
        f"{entry.place}: {entry.target}"
        for entry, to in own_imports
        if (entry.folder, to) in LAZY_ARROWS and not entry.lazy
    ]
    assert wrong == []


def test_folders_form_no_cycle(own_imports):
    """A cycle is allowed only through a function's own import."""
    graph: dict[str, set[str]] = {}
    for entry, to in own_imports:
        if not entry.lazy:
            graph.setdefault(entry.folder, set()).add(to)
    TopologicalSorter(graph).prepare()  # raises CycleError


def test_slow_packages_have_one_home_and_are_imported_late(imports):
    wrong = [
        f"{entry.place}: {entry.target}"
        for entry in imports
        if (package := entry.target.split(".")[0]) in LAZY_PACKAGES
        and not (entry.lazy and entry.folder in LAZY_PACKAGES[package])
    ]
    assert wrong == []


def test_reading_and_opensim_do_without_jax(imports):
    wrong = [
        f"{entry.place}: {entry.target}"
        for entry in imports
        if entry.folder in WITHOUT_JAX
        and entry.target.split(".")[0] in JAX_PACKAGES
        # The command line sets JAX up once threads are set.
        and not (entry.folder == "commands" and entry.lazy)
    ]
    assert wrong == []


def test_modules_stay_small():
    lengths = {
        str(file.relative_to(ROOT)): len(file.read_text(encoding="utf-8").splitlines())
        for file in PACKAGE.rglob("*.py")
    }
    assert {name: length for name, length in lengths.items() if length > 500} == {}


SLOW = {
    *("opensim", "ezc3d", "sklearn", "pandas", "matplotlib", "xarray", "jaxopt"),
    *("pooch", "requests", "distributed"),
}


@pytest.mark.parametrize(
    ("module", "absent"),
    [
        # Without JAX, too: once loaded it no longer listens to --threads.
        ("wrapjax", SLOW | {"jax"}),
        ("wrapjax.cli", SLOW | {"jax"}),
        ("wrapjax.subject", SLOW | {"jax"}),
        ("wrapjax.raw", SLOW | {"jax"}),
        ("wrapjax.api", SLOW),
    ],
)
def test_importing_is_light(module, absent):
    """As the source promises, so it happens: packages of others could pull slow ones in."""
    code = f"import sys, {module}; print(*sorted({absent!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout.split(), done.stderr) == (0, [], "")


def test_public_names_are_found_on_access():
    import wrapjax

    for name in dir(wrapjax):
        assert getattr(wrapjax, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'calibarte'"):
        _ = wrapjax.calibarte


def test_the_package_and_its_api_offer_the_same():
    import wrapjax.api

    assert set(dir(wrapjax)) - {"__version__", "InputError"} == set(wrapjax.api.__all__)


def test_dependencies_have_no_caps():
    """An upper limit here would keep users from combining the package with others."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lists = [
        project["build-system"]["requires"],
        project["project"]["dependencies"],
        *project["project"].get("optional-dependencies", {}).values(),
        *project.get("dependency-groups", {}).values(),
    ]
    requirements = [entry for entries in lists for entry in entries]
    assert len(requirements) > 10
    assert [entry for entry in requirements if re.search(r"<|==|~=|!=|@", entry)] == []


#: Places that exist on a developer's machine only.
MACHINE_PATH = re.compile(r"(?<![\w.])/(?:work|root|home|Users)/|[A-Z]:\\\\?Users")


def test_no_file_mentions_a_place_on_somebodys_machine():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git checkout")
    found = []
    for name in filter(None, listed.stdout.split("\0")):
        file = ROOT / name
        if not file.is_file():
            continue  # deleted, not yet committed
        text = file.read_bytes().decode("utf-8", errors="replace")
        for number, line in enumerate(text.splitlines(), start=1):
            if MACHINE_PATH.search(line):
                found.append(f"{name}:{number}: {line.strip()[:100]}")
    assert found == []


def test_a_place_on_somebodys_machine_would_be_found():
    places = [
        "/".join(["", "work", "main"]),
        "/".join(["", "home", "me"]),
    ]
    assert all(MACHINE_PATH.search(f"see {place}") for place in places)
    assert not MACHINE_PATH.search("https://example.org/home/page or ../work/main")
