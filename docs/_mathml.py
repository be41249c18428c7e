"""A hook of mkdocs: LaTeX becomes MathML, which browsers show without any script or font from elsewhere."""

from __future__ import annotations

import re
from html import unescape
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(html: str, **_: Any) -> str:
    """Replace what `pymdownx.arithmatex` has marked on a page.

    Raises:
      PluginError: a formula has a command that the converter does not know.
    """
    return FORMULA.sub(_mathml, html)


def _mathml(found: re.Match[str]) -> str:
    block = found[1] == "div"
    formula = convert(unescape(found[2]).strip(), display="block" if block else "inline")
    if "\\" in formula or "&#x0005C;" in formula:
        raise PluginError(f"formula {found[2].strip()!r}: has a command that latex2mathml does not know; use another")
    return f'<div class="formula">{formula}</div>' if block else formula
