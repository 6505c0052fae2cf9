"""Elements of an HTML page; all text is escaped in this module and nowhere else."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Sequence
from html import escape
from urllib.parse import quote

from wrapjax.report.style import Figure, to_svg

STYLE = """
:root { color-scheme: light; }
body { margin: 0 auto; max-width: 66rem; padding: 1.5rem; color: #1a1a1a; background: #fff;
  font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 .25rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .4rem; padding-top: .6rem; border-top: 1px solid #d8d8d8; }
p { margin: .4rem 0; max-width: 48rem; }
.under { color: #555; }
.verdict { border-left: .4rem solid #0072b2; background: #f1f6fa; padding: .6rem 1rem; margin: 1rem 0; }
.verdict.failed { border-color: #d55e00; background: #fdf3ec; }
.verdict p { max-width: none; }
.scroll { overflow-x: auto; margin: .8rem 0; }
table { border-collapse: collapse; font-size: .92rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: #555; padding-bottom: .3rem; }
th, td { padding: .22rem .8rem .22rem 0; text-align: left; vertical-align: top; }
thead th { border-bottom: 1px solid #888; vertical-align: bottom; }
.number { text-align: right; }
tr.total th, tr.total td { border-top: 1px solid #bbb; font-weight: 600; }
tbody th { font-weight: 400; }
figure { margin: .8rem 0; }
figure img { max-width: 100%; height: auto; }
figcaption { color: #333; font-size: .92rem; max-width: 48rem; }
ul { padding-left: 1.2rem; }
details { border-bottom: 1px solid #e4e4e4; padding: .25rem 0; }
summary { cursor: pointer; }
@media print {
  html { font-size: 11.5px; }
  body { max-width: none; padding: 0; }
  .scroll { overflow: visible; }
  th, td { padding-right: .5rem; }
  figure, table, .verdict { break-inside: avoid; }
  h2 { break-after: avoid; }
}
"""

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


def text(plain: str) -> str:
    """Escape plain text as HTML, with no line break between a number and ``N m``."""
    return _NUMBER_AND_UNIT.sub("\\1\N{NO-BREAK SPACE}N\N{NO-BREAK SPACE}m", escape(plain))


def paragraph(plain: str, kind: str = "") -> str:
    """Write plain text as a paragraph."""
    return f"<p{_class(kind)}>{text(plain)}</p>"


def link_line(link: Link, after: str) -> str:
    """Write a paragraph that begins with a link to a file, with plain text after it."""
    return f"<p>{_cell(link)}{text(after)}</p>"


def bullets(lines: Iterable[str]) -> str:
    """Write lines of plain text as a bulleted list."""
    return "<ul>" + "".join(f"<li>{text(line)}</li>" for line in lines) + "</ul>"


def box(content: str, kind: str) -> str:
    """Put HTML into a box of a CSS class."""
    return f"<div{_class(kind)}>{content}</div>"


def section(title: str, *content: str) -> str:
    """Put HTML elements under a heading."""
    return "\n".join([f"<section>\n<h2>{text(title)}</h2>", *content, "</section>"])


def header(title: str, under: str = "") -> str:
    """Write a page's title and a line under it."""
    below = f"\n{paragraph(under, 'under')}" if under else ""
    return f"<header><h1>{text(title)}</h1>{below}</header>"


def verdict(sentences: Sequence[str], *, fine: bool) -> str:
    """Write a page's conclusions in a box.

    Parameters
    ----------
    sentences
        Plain text, one paragraph each, the first in bold; empty ones are omitted.
    fine
        Whether the result can be used without reservation; otherwise the box has a warning color.
    """
    first, *others = sentences
    content = [f"<p><strong>{text(first)}</strong></p>", *(paragraph(line) for line in others if line)]
    return box("\n".join(content), "verdict" if fine else "verdict failed")


def folded(title: str, *content: str) -> str:
    """Hide HTML elements until the reader opens them by their title."""
    return "\n".join([f"<details>\n<summary>{text(title)}</summary>", *content, "</details>"])


def table(
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    caption: str,
    total: bool = False,
) -> str:
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
    head = f'<th scope="col">{text(header[0])}</th>' + "".join(
        f'<th scope="col"{_class(kind)}>{text(name)}</th>'
        for name, kind in zip(header[1:], kinds[1:], strict=True)
    )
    body = []
    for number, row in enumerate(lines):
        last = total and number == len(lines) - 1
        cells = "".join(
            f"<td{_class(kind)}>{_cell(cell)}</td>" for cell, kind in zip(row[1:], kinds[1:], strict=True)
        )
        body.append(f'<tr{_class("total" if last else "")}><th scope="row">{_cell(row[0])}</th>{cells}</tr>')
    return (
        f'<div class="scroll"><table><caption>{text(caption)}</caption>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n" + "\n".join(body) + "\n</tbody></table></div>"
    )


def picture(figure: Figure, *, alternative: str, caption: str) -> str:
    """Embed a figure as a separate image, because ids in SVG must be unique within a document.

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
    return (
        f'<figure><img alt="{text(alternative)}" src="data:image/svg+xml;base64,{data}">\n'
        f"<figcaption>{text(caption)}</figcaption></figure>"
    )


def page(title: str, content: Iterable[str]) -> str:
    """Write a complete HTML page that loads no other file."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{text(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(content)
        + "\n</main>\n</body>\n</html>\n"
    )


def _cell(plain: str) -> str:
    return (
        f'<a href="{escape(quote(plain.target))}">{text(plain)}</a>'
        if isinstance(plain, Link)
        else text(plain)
    )


def _class(kind: str) -> str:
    return f' class="{text(kind)}"' if kind else ""
