"""Elements of an HTML page, from the templates in ``templates/``, which escape all plain text."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from wrapjax.report.style import Figure, to_svg

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

_DIGITS = r"-?\d+(\.\d+)?(e[+-]?\d+)?"
# A cell is numeric also with a mark, a deviation or a second number: "* 1.5 ± 0.2", "< 0.001",
# "1.2 to 1.4", "2, 27", "0.3 (0.02)".
_NUMBER = re.compile(rf"(\* |< )?{_DIGITS}(( ± | to | of |, ){_DIGITS}| \((< )?{_DIGITS}\))?|nan|inf|\u2013")
_NUMBER_AND_UNIT = re.compile(r"(\d) N m\b")


class Link(str):
    """Plain text of a table's cell with a link to a file.

    Parameters
    ----------
    plain
        Text of the link.
    target
        File that it opens, as a relative path from the page, with slashes.
    """

    target: str

    def __new__(cls, plain: str, target: str) -> Link:
        """Make the text and attach its target."""
        link = super().__new__(cls, plain)
        link.target = target
        return link


@cache
def environment(package: str = "wrapjax.report", folder: str = "templates") -> Environment:
    """Return the environment of a package's templates: they escape all but HTML, and refuse unknown names."""
    # Imported late, as all that only pages need.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader(package, folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["words"] = text
    return made


def text(plain: str) -> Markup:
    """Escape plain text, with no line break between a number and ``N m``."""
    from markupsafe import Markup, escape

    unbroken = "\\1\N{NO-BREAK SPACE}N\N{NO-BREAK SPACE}m"
    return Markup(_NUMBER_AND_UNIT.sub(unbroken, str(escape(plain))))


@cache
def _elements() -> Any:
    """Macros of the elements."""
    return environment().get_template("elements.html.jinja").module


def paragraph(plain: str, kind: str = "") -> Markup:
    """Write plain text as a paragraph of a CSS class."""
    return _elements().paragraph(plain, kind)


def link_line(link: Link, after: str) -> Markup:
    """Write a paragraph that begins with a link to a file, with plain text after it."""
    return _elements().link_line(link, after)


def bullets(lines: Iterable[str]) -> Markup:
    """Write lines of plain text as a bulleted list."""
    return _elements().bullets(list(lines))


def box(*content: Markup | str, kind: str) -> Markup:
    """Put elements into a box of a CSS class."""
    return _elements().box(content, kind)


def section(title: str, *content: Markup | str) -> Markup:
    """Put elements under a heading."""
    return _elements().section(title, content)


def header(title: str, under: str = "") -> Markup:
    """Write a page's title and a line under it."""
    return _elements().header(title, under)


def verdict(sentences: Sequence[str], *, fine: bool) -> Markup:
    """Write a page's conclusions in a box.

    Parameters
    ----------
    sentences
        Plain text, one paragraph each, the first in bold; empty ones are omitted.
    fine
        Whether the result can be used without reservation; otherwise the box has a warning color.
    """
    first, *others = sentences
    return _elements().verdict(first, others, fine)


def folded(title: str, *content: Markup | str) -> Markup:
    """Hide elements until the reader opens them by their title."""
    return _elements().folded(title, content)


def table(
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    caption: str,
    total: bool = False,
) -> Markup:
    """Write a table whose first column names the rows; columns of numbers are right-aligned.

    Parameters
    ----------
    header, rows
        Plain texts; `Link` for cells with a link.
    caption
        Contents of the table, with units.
    total
        Whether the last row summarizes the others.
    """
    lines = [tuple(row) for row in rows]
    kinds = [
        "number" if lines and all(_NUMBER.fullmatch(cell) for cell in column) else ""
        for column in zip(*lines, strict=True)
    ] or [""] * len(header)
    if len(kinds) != len(header):
        raise ValueError(f"{len(header)} names of columns, {len(kinds)} columns")
    return _elements().table(header, lines, kinds, caption, total)


def picture(figure: Figure, *, alternative: str, caption: str) -> Markup:
    """Embed a figure.

    Parameters
    ----------
    figure
        Figure to embed.
    alternative
        Description of the figure for readers who cannot see it.
    caption
        Contents of the figure and how to read it, with units.
    """
    data = base64.b64encode(to_svg(figure).encode()).decode()
    return _elements().picture(data, alternative, caption)


def page(title: str, content: Iterable[Markup | str]) -> str:
    """Write a complete HTML page that loads no other file."""
    from markupsafe import Markup

    style = files("wrapjax.report").joinpath("templates/page.css").read_text(encoding="utf-8")
    template = environment().get_template("page.html.jinja")
    return template.render(title=title, style=Markup(style), content=content)
