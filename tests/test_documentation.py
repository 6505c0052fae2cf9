"""Defends: public names are documented completely, and documents name files and commands that exist."""

import inspect
import re
from pathlib import Path

import pytest

import wrapjax

ROOT = Path(__file__).parents[1]
FUNCTIONS = [name for name in wrapjax.__all__ if inspect.isfunction(getattr(wrapjax, name))]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def _sections(text: str) -> dict[str, str]:
    """Split a numpy docstring into its sections by their titles."""
    parts = re.split(r"^([A-Z]\w+)\n-{3,}\n", inspect.cleandoc(text), flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_public_functions_document_every_argument_and_the_result(name):
    function = getattr(wrapjax, name)
    sections = _sections(function.__doc__ or "")
    listed = re.findall(r"^(\w[\w, ]*)$", sections.get("Parameters", ""), flags=re.M)
    documented = {one.strip() for line in listed for one in line.split(",")}
    signature = inspect.signature(function)
    assert documented == set(signature.parameters)
    if signature.return_annotation not in (None, "None"):
        assert sections.get("Returns", "").strip()


def test_the_reference_lists_every_public_name():
    text = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\.\. auto(?:function|class):: (\w+)$", text, flags=re.M)
    assert sorted(listed) == sorted(name for name in wrapjax.__all__ if name != "__version__")


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


@pytest.mark.parametrize("name", wrapjax.__all__)
def test_public_names_begin_with_a_sentence(name):
    first = (getattr(wrapjax, name).__doc__ or "").strip().splitlines()[0]
    assert first.endswith(".") and len(first.split()) >= 4, first


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda file: file.name)
def test_documents_name_files_that_exist(document):
    """Links, and paths in backquotes that begin with one of the project's folders."""
    text = document.read_text(encoding="utf-8")
    links = [document.parent / link for link in re.findall(r"\]\((?!http)([^)#]+)", text)]
    folders = r"(?:wrapjax|tests|docs|benchmarks|validation|notebooks)"
    paths = [ROOT / path for path in re.findall(rf"`({folders}/[\w./-]+)`", text)]
    package = [ROOT / "wrapjax" / path for path in re.findall(r"\| `((?:[a-z_]+/)+(?:[a-z_]+\.py)?)`", text)]
    missing = [path for path in (*links, *paths, *package) if not path.exists()]
    assert [str(path.relative_to(ROOT)) for path in missing] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda file: file.name)
def test_documents_name_commands_that_exist(document):
    text = document.read_text(encoding="utf-8")
    commands = set(re.findall(r"(?:^|`|\n)wrapjax ([a-z]+)", text))
    known = {file.stem for file in (ROOT / "wrapjax" / "cli").glob("*.py")}
    assert commands - known == set()
    modules = set(re.findall(r"python -m ((?:benchmarks|validation)[\w.]*)", text))
    files = {name: ROOT / name.replace(".", "/") for name in modules}
    wrong = [name for name, file in files.items() if not (file.with_suffix(".py").exists() or file.is_dir())]
    assert wrong == []
