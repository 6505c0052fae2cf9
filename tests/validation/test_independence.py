"""Independence of the blind bank from the package, and of its banks from each other."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "validation" / "blind"
#: Packages that the simulator and the scorer may import besides the standard library.
ALLOWED = {"numpy", "scipy", "opensim", "matplotlib", "validation"}


def _imports(file: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            names.add(node.module or "")
    return names


def test_blind_bank_does_not_import_the_package():
    import sys

    for file in sorted(PACKAGE.rglob("*.py")):
        for name in _imports(file):
            top = name.split(".")[0]
            assert top in ALLOWED or top in sys.stdlib_module_names, f"{file.name} imports {name}"
            assert top != "validation" or name.startswith("validation.blind"), f"{file.name} imports {name}"
            assert name != "importlib", f"{file.name} could import anything"
        assert "__import__" not in file.read_text(encoding="utf-8")


def test_opensim_is_imported_by_one_module():
    where = {f.name for f in PACKAGE.rglob("*.py") if "opensim" in {n.split(".")[0] for n in _imports(f)}}
    assert where == {"opensim_leg.py"}


def test_curves_of_test_banks_are_not_in_the_development_bank():
    from validation.blind.families import BANKS

    assert set(BANKS["test"]).isdisjoint(BANKS["development"])
    assert "millard" not in BANKS["development"] and len(BANKS["development"]) >= 2


def test_banks_share_no_seed():
    from validation.blind.plan import BANK_SIZES

    assert len({bank.seed for bank in BANK_SIZES.values()}) == len(BANK_SIZES)
    assert all(bank.people >= 40 for bank in BANK_SIZES.values())


def test_effects_table_is_up_to_date():
    from validation.blind.effect_table import effect_table

    assert (PACKAGE / "EFFECTS.md").read_text(encoding="utf-8") == effect_table()
