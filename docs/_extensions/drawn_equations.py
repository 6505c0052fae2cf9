"""Sphinx extension: equations as inline SVG, drawn by matplotlib.

They look the same everywhere, without a script, a network or a mathematical font of the reader's system.
"""

from __future__ import annotations

import html
from typing import Any

from docutils import nodes
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.textpath import TextPath
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

#: Size of the letters in units of the drawing, and in the page's `em`.
_SIZE, _EM = 20.0, 1.08
_FONT = FontProperties(math_fontfamily="cm")
_COMMANDS = {Path.MOVETO: "M", Path.LINETO: "L", Path.CURVE3: "Q", Path.CURVE4: "C", Path.CLOSEPOLY: "Z"}


def draw(equation: str) -> str:
    """Draw an equation in TeX as SVG, whose baseline is that of the surrounding text."""
    path = TextPath((0.0, 0.0), f"${equation}$", size=_SIZE, prop=_FONT)
    box = path.get_extents()
    left, width = box.x0 - 0.5, box.width + 1.0
    bottom, top = min(box.y0, 0.0) - 0.5, box.y1 + 0.5
    words = []
    for points, code in path.iter_segments():
        numbers = "" if code == Path.CLOSEPOLY else ",".join(f"{value:.1f}" for value in points)
        words.append(_COMMANDS[code] + numbers)
    scale = _EM / _SIZE
    return (
        f'<svg class="math" role="img" aria-label="{html.escape(equation)}" '
        f'viewBox="{left:.1f} {-top:.1f} {width:.1f} {top - bottom:.1f}" '
        f'style="width:{scale * width:.3f}em;vertical-align:{scale * bottom:.3f}em">'
        f'<path transform="scale(1,-1)" d="{"".join(words)}"/></svg>'
    )


def visit_inline_equation(translator: HTML5Translator, node: nodes.math) -> None:
    """Write an equation within a sentence."""
    translator.body.append(draw(node.astext()))
    raise nodes.SkipNode


def visit_equation(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write an equation on lines of its own, with its number where it has a label."""
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    identifiers = "".join(f' id="{identifier}"' for identifier in node["ids"][:1])
    equation = " ".join(node.astext().split()).replace(r"\frac", r"\dfrac")
    lines = "".join(f"<div>{draw(line)}</div>" for line in equation.split(r"\\"))
    translator.body.append(f'<div class="equation"{identifiers}><div>{lines}</div>{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer, which `html_math_renderer` in `conf.py` selects."""
    app.add_html_math_renderer("drawn", (visit_inline_equation, None), (visit_equation, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
