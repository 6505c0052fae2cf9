"""Sphinx extension: directive ``command-help``, a section with the help text of each ``wrapjax`` command."""

from __future__ import annotations

import os
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

#: Characters of a line of help text.
_WIDTH = 96


class CommandHelp(SphinxDirective):
    """Write the help of all commands, in the order of ``wrapjax --help``."""

    def run(self) -> list[nodes.Node]:
        """Read the help from the parser of the command line."""
        from wrapjax.cli.command_line import build_parser

        os.environ["COLUMNS"] = str(_WIDTH)  # argparse wraps lines at the width of the terminal
        sections: list[nodes.Node] = []
        for name, parser in build_parser()[1].items():
            identifier = nodes.make_id(f"command-{name}")
            section = nodes.section(ids=[identifier], names=[f"command {name}"])
            self.state.document.note_explicit_target(section)
            section += nodes.title(text=f"wrapjax {name}")
            parser.description, description = None, parser.description or ""
            help_text = parser.format_help()
            section += nodes.paragraph(text=description)
            section += nodes.literal_block(help_text, help_text, language="text")
            sections.append(section)
        return sections


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
