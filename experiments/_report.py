"""A page that shows exhibits beside the paper's numbers: one file that needs no other."""

from __future__ import annotations

import base64
import subprocess
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from pathlib import Path

from experiments._exhibits import Comparison, Exhibit
from scenarios.files import written_whole

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #20262c; margin: 2rem auto; max-width: 60rem; padding: 0 1rem; }
h1 { font-size: 1.6rem; }
h2 { font-size: 1.2rem; margin: 2.5rem 0 .3rem; border-top: 1px solid #dde1e5; padding-top: 1rem; }
img { max-width: 100%; height: auto; } p, dd { max-width: 46rem; } dt { font-weight: 600; } dd { margin: 0 0 .4rem; }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums; font-size: .92rem; }
th, td { text-align: left; padding: .25rem .9rem .25rem 0; border-bottom: 1px solid #e8ebee; vertical-align: top; }
code { font-size: .9em; background: #f1f3f5; padding: .1em .3em; overflow-wrap: anywhere; }
.files { font-size: .85rem; color: #5b6570; }
"""


def write_report(path: Path, title: str, facts: Mapping[str, str], exhibits: Sequence[Exhibit]) -> None:
    """Write the page.

    Args:
      path: of the page.
      title: its headline.
      facts: what it is about and how it was made, by name.
      exhibits: in the order of the page.
    """
    told = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in facts.items())
    sections = "\n".join(map(_section, exhibits))
    page = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n<body><h1>{escape(title)}</h1>\n"
        f"<dl>{told}</dl>\n{sections}\n</body></html>\n"
    )
    with written_whole(path) as file:
        file.write(page.encode())


def _section(exhibit: Exhibit) -> str:
    picture = BytesIO()
    exhibit.figure.savefig(picture, format="png")
    source = base64.b64encode(picture.getvalue()).decode()
    files = ", ".join(f"<code>{exhibit.name}.{ending}</code>" for ending in ("png", "pdf", "csv"))
    return (
        f'<section id="{exhibit.name}"><h2>{escape(exhibit.title)}</h2><p>{escape(exhibit.text)}</p>\n'
        f'<img alt="{escape(exhibit.title)}" src="data:image/png;base64,{source}">\n'
        f'{_table(exhibit.compared)}<p class="files">{files}</p></section>'
    )


def _table(compared: Sequence[Comparison]) -> str:
    if not compared:
        return ""
    rows = "\n".join(
        f"<tr><td>{escape(one.what)}</td><td>{escape(one.ours)}</td><td>{escape(one.paper)}</td></tr>"
        for one in compared
    )
    return f"<table><thead><tr><th></th><th>here</th><th>paper</th></tr></thead><tbody>\n{rows}\n</tbody></table>\n"


def source_version() -> str:
    """The project's version, and the commit that the source code is at, if it lies in a repository."""
    root = Path(__file__).resolve().parents[1]

    def ask(*words: str) -> str:
        answer = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=True)
        return answer.stdout.strip()

    try:
        number = f"jaxfrenet {version('jaxfrenet')}"
    except PackageNotFoundError:
        number = "jaxfrenet, not installed"
    try:
        if Path(ask("rev-parse", "--show-toplevel")) != root:
            return number
        changed = " with changes" if ask("status", "--porcelain", "--untracked-files=no") else ""
        return f"{number}, commit {ask('rev-parse', '--short=12', 'HEAD')}{changed}"
    except (OSError, subprocess.CalledProcessError):
        return number
