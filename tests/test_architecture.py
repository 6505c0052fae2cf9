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

#: What each part may import of ours; a part is a folder of the package, or a module beside the folders.
#: In this order nothing imports what comes later, but for results that write themselves (`LATE`).
ARROWS: dict[str, set[str]] = {
    "errors": set(),
    "progress": set(),
    "renamed": set(),
    "threads": set(),
    "io": {"errors"},
    "jax_setup": {"io"},
    "subject": {"errors", "progress", "io"},
    "skeleton": {"errors"},
    "osim": {"errors", "progress", "threads", "io", "skeleton"},
    "geometry": {"errors", "threads", "skeleton"},
    "muscle": set(),
    "model": {"geometry", "muscle"},
    "path_sources": {
        *("errors", "progress", "io", "jax_setup", "subject", "skeleton", "osim"),
        *("geometry", "muscle", "model"),
    },
    "preprocessing": {
        *("errors", "renamed", "progress", "io", "jax_setup", "subject", "skeleton", "osim", "geometry"),
    },
    "datasets": {
        *("errors", "progress", "io", "jax_setup", "subject", "skeleton", "osim"),
        *("geometry", "muscle", "model"),
    },
    "calibration": {
        *(
            "errors",
            "renamed",
            "progress",
            "io",
            "jax_setup",
            "subject",
            "osim",
            "geometry",
            "muscle",
            "model",
        ),
        "path_sources",
    },
    "joints": {
        *("errors", "progress", "io", "skeleton", "osim", "geometry", "preprocessing", "calibration"),
    },
    "comparison": {"errors", "renamed", "progress", "io", "subject", "osim", "path_sources", "calibration"},
    "diagnosis": {
        *(
            "errors",
            "renamed",
            "progress",
            "threads",
            "io",
            "subject",
            "skeleton",
            "osim",
            "geometry",
            "muscle",
            "model",
        ),
        *("path_sources", "calibration"),
    },
    "evaluation": {
        *("errors", "io", "jax_setup", "subject", "osim", "geometry", "muscle", "model", "path_sources"),
        "calibration",
    },
    "contact_forces": {
        *("errors", "renamed", "io", "jax_setup", "subject", "preprocessing", "skeleton", "osim", "geometry"),
        *("muscle", "model", "path_sources", "calibration", "comparison", "diagnosis", "evaluation"),
    },
    "cohorts": {
        *("errors", "progress", "io", "jax_setup", "subject", "path_sources", "calibration", "comparison"),
        "diagnosis",
    },
    "report": {
        *("errors", "io", "subject", "preprocessing", "skeleton", "geometry", "muscle", "model"),
        "osim",  # the model and its bones, to show them in motion
        *("path_sources", "calibration", "joints", "comparison", "diagnosis", "evaluation", "contact_forces"),
        "datasets",  # the virtual person's truth is drawn beside what calibration found
    },
    "demonstration": {
        *("errors", "progress", "io", "subject", "datasets", "osim", "geometry", "model"),
        *("path_sources", "calibration", "diagnosis", "report"),
    },
    # The commands call the public functions; of the rest they need what they print.
    "cli": {
        *("errors", "progress", "io", "jax_setup", "subject", "preprocessing", "datasets", "geometry"),
        *(
            "path_sources",
            "calibration",
            "joints",
            "comparison",
            "diagnosis",
            "evaluation",
            "contact_forces",
            "cohorts",
            "report",
        ),
        *("demonstration", "__init__"),
    },
    "__init__": set(),
    "__main__": {"cli"},
    "api": {"__init__"},
}

#: Folder of `geometry` that describes a model's bodies and joints by NumPy alone: a part of its own.
SKELETON = "skeleton"

#: Packages of others that only these folders may import, inside functions.
LAZY_PACKAGES: dict[str, set[str]] = {
    "opensim": {"osim"},
    "ezc3d": {"preprocessing"},
    "matplotlib": {"report"},
    "rich": {"progress"},
    "pandas": set(),
    "pooch": {"datasets"},
    "requests": {"datasets"},
    "dask": {"cohorts"},
    "distributed": {"cohorts"},
    "dask_jobqueue": {"cohorts"},
    "sklearn": {"geometry"},
    "xarray": {"report"},
    "jinja2": {"report"},
    "markupsafe": {"report"},
}

#: Parts that must do without JAX, so that a folder can be checked before it is loaded.
WITHOUT_JAX = {
    *("errors", "progress", "renamed", "io", "jax_setup", "subject", "skeleton", "osim", "cli", "api"),
    *("__init__", "__main__"),
}
JAX_PACKAGES = {"jax", "jaxlib", "equinox", "optimistix", "lineax", "jaxopt"}


@dataclass(frozen=True)
class Import:
    """One import statement of the package."""

    place: str
    module: str
    target: str
    lazy: bool

    @property
    def ours(self) -> bool:
        return self.target.split(".")[0] == "wrapjax"

    @property
    def part(self) -> str:
        return _part(self.module.partition(".")[2])

    @property
    def target_part(self) -> str:
        return _part(self.target.partition(".")[2])

    @property
    def light(self) -> bool:
        """Whether a command may import its target before it knows that there is work to do."""
        return self.target_part in WITHOUT_JAX or self.target == "wrapjax.evaluation.metrics"


def _part(module: str) -> str:
    """Name the part that a module is in, by its dotted name without the package's."""
    parts = (module or "__init__").split(".")
    if parts[0] == "geometry" and len(parts) > 1 and parts[1] == SKELETON:
        return "skeleton"
    return parts[0]


def _modules() -> dict[str, Path]:
    """Find all modules of the package by their dotted names, packages by their own."""
    found = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        parts = file.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


MODULES = _modules()


def imports_of(module: str) -> list[Import]:
    """Find all imports of a module, except those that only type checkers follow."""
    found = []
    file = MODULES[module]

    def visit(node: ast.AST, lazy: bool) -> None:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            return
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file.name}:{node.lineno}: imports are absolute in this package"
            # 'from wrapjax.report import markup' names a module, not an attribute.
            full = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in MODULES else node.module or "" for name in full]
        place = f"{file.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}"
        found.extend(Import(place, module, name, lazy) for name in names)
        lazy = lazy or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
        for child in ast.iter_child_nodes(node):
            visit(child, lazy)

    visit(ast.parse(file.read_text(encoding="utf-8")), False)
    return found


@pytest.fixture(scope="module")
def imports() -> list[Import]:
    return [entry for module in MODULES for entry in imports_of(module)]


@pytest.fixture(scope="module")
def own_imports(imports) -> list[Import]:
    """Imports of ours between parts."""
    return [entry for entry in imports if entry.ours and entry.part != entry.target_part]


def test_every_part_has_a_row_in_the_table():
    assert {_part(module.partition(".")[2]) for module in MODULES} == set(ARROWS)


def test_arrows_go_one_way(own_imports):
    wrong = [
        f"{entry.place}: {entry.target}"
        for entry in own_imports
        if entry.target_part not in ARROWS[entry.part] and not (entry.lazy and entry.target_part == "report")
    ]
    assert wrong == []


def test_what_takes_long_to_import_is_imported_late(own_imports):
    wrong = [
        f"{entry.place}: {entry.target}"
        for entry in own_imports
        if not entry.lazy
        and entry.part not in ("api", "__main__")
        and (entry.target_part == "report" or (entry.part == "cli" and not entry.light))
    ]
    assert wrong == []


def test_parts_form_no_cycle(own_imports):
    """Only results that write their own reports point up, by imports inside their methods."""
    graph: dict[str, set[str]] = {}
    for entry in own_imports:
        if entry.target_part != "report" or entry.part in ("demonstration", "cli"):
            graph.setdefault(entry.part, set()).add(entry.target_part)
    TopologicalSorter(graph).prepare()  # raises CycleError


def test_modules_form_no_cycle(imports):
    """Imports inside functions count, too."""
    graph: dict[str, set[str]] = {}
    for entry in imports:
        if entry.ours and entry.module != entry.target:
            graph.setdefault(entry.module, set()).add(entry.target)
    TopologicalSorter(graph).prepare()


def test_no_function_is_hidden_by_a_package():
    """Importing ``wrapjax.x.y`` sets ``x`` on the package: it may be no public name as well."""
    import wrapjax

    folders = {module.split(".")[1] for module in MODULES if module != "wrapjax"}
    assert folders & (set(dir(wrapjax)) - {"__version__"}) == set()


def test_packages_list_nothing():
    """A name is imported from the module that defines it: packages hold a sentence, and no second list."""
    wrong = [
        module
        for module, file in MODULES.items()
        if file.name == "__init__.py"
        and module != "wrapjax"
        and len(ast.parse(file.read_text(encoding="utf-8")).body) != 1
    ]
    assert wrong == []


def test_slow_packages_have_one_home_and_are_imported_late(imports):
    wrong = [
        f"{entry.place}: {entry.target}"
        for entry in imports
        if (package := entry.target.split(".")[0]) in LAZY_PACKAGES
        and not (entry.lazy and entry.part in LAZY_PACKAGES[package])
    ]
    assert wrong == []


def test_reading_and_opensim_do_without_jax(imports):
    wrong = [
        f"{entry.place}: {entry.target}"
        for entry in imports
        if entry.part in WITHOUT_JAX
        and entry.target.split(".")[0] in JAX_PACKAGES
        # The command line sets JAX up once threads are set.
        and not (entry.part in ("cli", "jax_setup") and entry.lazy)
    ]
    assert wrong == []


def test_modules_stay_small():
    lengths = {module: len(file.read_text(encoding="utf-8").splitlines()) for module, file in MODULES.items()}
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
        ("wrapjax.cli.command_line", SLOW | {"jax"}),
        ("wrapjax.subject.subject", SLOW | {"jax"}),
        ("wrapjax.preprocessing.checks.consistency_checks", SLOW | {"jax"}),
        ("wrapjax.calibration.calibration", SLOW),
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


def test_earlier_names_warn():
    import wrapjax
    import wrapjax.api
    from wrapjax.calibration.problem import build_objective

    with pytest.warns(DeprecationWarning, match=r"wrapjax\.build_objective"):
        assert wrapjax.prepare is build_objective
    with pytest.warns(DeprecationWarning, match=r"is now wrapjax\.calibrate"):
        assert wrapjax.api.calibrate is wrapjax.calibrate


def test_earlier_argument_names_warn():
    from wrapjax.renamed import renamed_arguments

    @renamed_arguments(tell="log")
    def work(log: str = "") -> str:
        return log

    with pytest.warns(DeprecationWarning, match=r"'tell' of work\(\) is now 'log'"):
        assert work(tell="said") == "said"
    assert work(log="said") == "said"


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
