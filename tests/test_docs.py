"""The documentation holds: every snippet runs and prints what it says, every command parses, the pages build."""

from __future__ import annotations

import contextlib
import importlib
import io
import re
import shlex
import subprocess
import sys
from dataclasses import fields
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

from scenarios import command_line

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
FENCED = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"[-+]?\d+(\.\d*)?(e[-+]?\d+)?")
"""Numbers may differ in their last digits from one processor to the next: what is printed is compared without them."""


def blocks(page: Path) -> list[tuple[str, str]]:
    """Languages and contents of a page's fenced blocks."""
    return FENCED.findall(page.read_text(encoding="utf-8"))


def shown(page: Path) -> str:
    return str(page.relative_to(ROOT))


def with_python() -> list[Path]:
    return [page for page in PAGES if any(language == "python" for language, _ in blocks(page))]


@pytest.mark.parametrize("page", with_python(), ids=shown)
def test_the_snippets_of_a_page_run_in_order(page, tmp_path, monkeypatch):
    if page.name == "environment.md":
        pytest.importorskip("gymnasium")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("scenarios.cache.user_cache", lambda: tmp_path)
    namespace, said = {}, ""
    for language, content in blocks(page):
        if language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as output:
                exec(compile(content, shown(page), "exec"), namespace)
            said = output.getvalue()
        elif language == "text":
            assert NUMBER.sub("#", said) == NUMBER.sub("#", content), said


def test_guides_have_snippets():
    guides = {"first-plan.md", "cost-term.md", "own-scenarios.md", "environment.md"}
    assert guides <= {page.name for page in with_python()}


def commands(page: Path) -> list[list[str]]:
    """Words of the commands that a page shows in blocks of shell code, without comments."""
    text = "\n".join(content for language, content in blocks(page) if language == "sh").replace("\\\n", " ")
    words = [shlex.split(line, comments=True) for line in text.splitlines()]
    return [line for line in words if line[:2] == ["python", "-m"]]


def mentioned(page: Path) -> list[tuple[str, list[str]]]:
    """Modules and options of the commands that a page mentions in its text; these may leave out values."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    found = re.findall(r"`python -m ([\w.]+)([^`]*)`", text)
    return [(module, re.findall(r"(?<!\S)--[\w-]+", rest)) for module, rest in found]


@pytest.fixture
def options_of(monkeypatch):
    """`options_of(module)`: the dataclass of a command's options."""

    def of(module: str) -> type:
        asked = []
        command = importlib.import_module(module)
        monkeypatch.setattr(command, "run_command", lambda options, *_: asked.append(options))
        command.main([])
        return asked[0]

    return of


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=shown)
def test_the_commands_of_a_page_parse(page, options_of):
    for _, _, module, *arguments in commands(page):
        options = options_of(module)
        assert isinstance(command_line._parse(options, module, arguments), options)


@pytest.mark.parametrize("page", [page for page in PAGES if mentioned(page)], ids=shown)
def test_the_options_that_a_page_mentions_exist(page, options_of):
    for module, flags in mentioned(page):
        assert find_spec(module), module
        known = {f"--{field.name.replace('_', '-')}" for field in fields(options_of(module))}
        assert set(flags) <= known, module


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The built pages."""
    for package in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
        if find_spec(package) is None:
            pytest.skip(f"{package} is not installed: pip install 'jaxfrenet[docs]'")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_pages_build_without_a_warning(site):
    assert all((site / page.relative_to(DOCS)).with_suffix(".html").is_file() for page in PAGES)


def test_pages_load_nothing_from_elsewhere(site):
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe)[^>]*\ssrc=\"?([^\s\">]+)", text)
        loaded += re.findall(r"<link[^>]*rel=\"?stylesheet[^>]*href=\"?([^\s\">]+)", text)
        assert loaded and not [address for address in loaded if "//" in address], page


def test_formulas_are_mathml(site):
    text = (site / "mathematics.html").read_text(encoding="utf-8")
    assert text.count("<math") > 40
    assert "arithmatex" not in text and "\\frac" not in text


def test_a_formula_that_cannot_be_shown_stops_the_build(site):
    """`site` skips this where mkdocs is not installed."""
    spec = spec_from_file_location("mathml", DOCS / "_mathml.py")
    assert spec and spec.loader
    hook = module_from_spec(spec)
    spec.loader.exec_module(hook)
    assert "<mi>a</mi>" in hook.on_page_content(r'<span class="arithmatex">\(a\)</span>')
    with pytest.raises(Exception, match=r"unknowable.*has a command that latex2mathml does not know"):
        hook.on_page_content(r'<span class="arithmatex">\(\unknowable{a}\)</span>')


@pytest.mark.parametrize("package", ["jaxfrenet", "jaxfrenet.environment", "scenarios", "ppo"])
def test_all_that_is_public_is_in_the_reference(site, package):
    text = (site / "api" / f"{package.rpartition('.')[2]}.html").read_text(encoding="utf-8")
    missing = [name for name in importlib.import_module(package).__all__ if f'id="{package}.{name}"' not in text]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=shown)
def test_what_is_named_by_its_module_exists(page):
    """`package.module.name` in code marks, and files of the packages."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    for name in re.findall(r"`((?:jaxfrenet|scenarios|ppo|jf)\.[\w.]+)(?:\([^`]*\))?`", text):
        first, *rest = name.replace("jf.", "jaxfrenet.", 1).split(".") if name.startswith("jf.") else name.split(".")
        at = importlib.import_module(first)
        for part in rest:
            path = f"{at.__name__}.{part}" if hasattr(at, "__path__") else None
            at = importlib.import_module(path) if path and not hasattr(at, part) else getattr(at, part)
    for file in re.findall(r"`((?:jaxfrenet|scenarios|ppo|experiments)/[\w/.]+)`", text):
        assert (ROOT / file).exists(), file
