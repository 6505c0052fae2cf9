"""Sphinx extension: equations as MathML, which browsers draw without a script and without a network."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator


def visit_inline_equation(translator: HTML5Translator, node: nodes.math) -> None:
    """Write an equation within a sentence."""
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def visit_equation(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write an equation on a line of its own, with its number where it has a label."""
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    identifiers = "".join(f' id="{identifier}"' for identifier in node["ids"][:1])
    text = tex2mathml(node.astext(), as_block=True)
    translator.body.append(f'<div class="equation"{identifiers}>{text}{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer, which `html_math_renderer` in `conf.py` selects."""
    app.add_html_math_renderer("mathml", (visit_inline_equation, None), (visit_equation, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
