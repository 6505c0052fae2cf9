"""The tables of docs/effects.md are those of the catalogue."""

from pathlib import Path

from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.table import effect_tables, with_tables

DOCUMENT = Path(__file__).parents[2] / "docs" / "effects.md"


def test_document_has_the_tables_of_the_catalogue():
    """Run ``python -m wrapjax.diagnosis.effects.table docs/effects.md`` after a change of the catalogue."""
    text = DOCUMENT.read_text(encoding="utf-8")
    assert with_tables(text) == text


def test_tables_name_every_effect_and_parameter():
    tables = effect_tables()
    for definition in CATALOGUE.values():
        assert f"`{definition.id}`" in tables and definition.meaning in tables
        assert all(f"`{parameter.name}`" in tables for parameter in definition.parameters)
