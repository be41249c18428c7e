"""The player: one page that shows recordings in any browser, without network access."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

import jaxfrenet as jf
from experiments._player_data import player_data
from experiments._recording import Recording

SOURCES = Path(__file__).parent / "player"
MODULES = (
    "format.mjs",
    "canvas.mjs",
    "camera.mjs",
    "episode.mjs",
    "bundle.mjs",
    "road_view.mjs",
    "legend.mjs",
    "chart.mjs",
    "playback.mjs",
    "gestures.mjs",
    "player.mjs",
)
"""The script's parts: each imports from those before it alone."""
IMPORT = re.compile(r'^import \{[^}]*\} from "\./\w+\.mjs";\n', flags=re.MULTILINE)
EXPORT = re.compile(r"^export (?=async function |function |const |class )", flags=re.MULTILINE)


def player_page(recordings: Sequence[Recording], vehicle: jf.Vehicle) -> str:
    """The page, as the text of an HTML file; arguments as for `player_data`."""
    return page(player_data(recordings, vehicle))


def page(data: dict[str, Any]) -> str:
    """The page that shows what `player_data` made.

    A browser runs nothing on it but the player's own script, and loads nothing from anywhere: its content security
    policy names script and style by their hashes. What comes from a scenario's file is data, never markup.
    """
    script, style = joined_modules(), _source("player.css")
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    return Template(_source("player.html")).substitute(
        policy=policy, title=html.escape(data["name"]), style=style, data=_as_json(data), script=script
    )


def joined_modules() -> str:
    """The script's parts as one module: without the lines that import from each other, and without `export`."""
    return "\n".join(EXPORT.sub("", IMPORT.sub("", _source(name))) for name in MODULES)


def _source(name: str) -> str:
    return (SOURCES / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _as_json(data: dict[str, Any]) -> str:
    """JSON that cannot end the element that it stands in."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
