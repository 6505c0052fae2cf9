"""Values as TOML writes them, for whatever writes a subject's settings."""

from __future__ import annotations

import json
from collections.abc import Sequence


def quoted(text: str) -> str:
    """Write a string."""
    # TOML's basic strings are JSON's.
    return json.dumps(text, ensure_ascii=False)


def quoted_list(names: Sequence[str]) -> str:
    """Write a list of strings."""
    return f"[{', '.join(map(quoted, names))}]"
