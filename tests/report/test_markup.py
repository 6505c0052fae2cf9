"""Defends: pages escape whatever is not an element, and elements are well-formed."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.report.page import Page
from wrapjax.report import markup

# Without control characters and other characters that HTML has not.
WORDS = st.text(
    st.characters(exclude_categories=("Cc", "Cs", "Zl", "Zp", "Zs", "Cn")), min_size=1, max_size=20
)


@settings(max_examples=50, deadline=None)
@given(WORDS, WORDS, WORDS)
def test_any_text_is_shown_as_it_is(title, words, name):
    linked = markup.Link(words, f"{name}/report.html")
    page = Page(
        markup.page(
            title,
            [
                markup.header(title, words),
                markup.verdict([words, "", name], fine=False),
                markup.section(title, markup.paragraph(words), words, markup.bullets([name])),
                markup.folded(name, markup.table(["a", name], [[linked, words]], caption=title)),
            ],
        )
    )
    shown = [words, name, title]
    assert all(one in page.words for one in shown)
    assert [entry["class"] for entry in page.all("div")] == ["verdict failed", "scroll"]
    assert len(page.all("section")) == len(page.all("details")) == len(page.all("a")) == 1


def test_a_row_of_another_length_is_an_error():
    with pytest.raises(ValueError, match="2 names"):
        markup.table(["a", "b"], [["1", "2", "3"]], caption="c")
    with pytest.raises(ValueError, match="zip"):
        markup.table(["a", "b"], [["1", "2"], ["3"]], caption="c")


def test_columns_of_numbers_are_aligned():
    page = Page(
        markup.page("t", [markup.table(["a", "b", "c"], [["x", "1.5 \u00b1 0.2", "y 2"]], caption="")])
    )
    assert [entry.get("class") for entry in page.all("td")] == ["number", None]
    assert "3\u00a0N\u00a0m" in markup.paragraph("3 N m")
