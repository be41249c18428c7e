"""What all commands share: options, one-line errors, compiled programs that are kept, folders, tables."""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import sys
import tempfile
from collections.abc import Callable, Collection, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import jax

from scenarios.errors import ScenarioError

Options = TypeVar("Options")


class UserError(Exception):
    """Something that the user can mend; the message is one line that says what, where and what to do."""


def run_command(
    options_type: type[Options],
    body: Callable[[Options], None],
    module: str,
    arguments: Sequence[str] | None = None,
    expand: Callable[[Sequence[str]], Sequence[str]] = list,
) -> None:
    """Parse the options and run a command.

    Args:
      options_type: a dataclass; its fields are the command's options.
      body: the command.
      module: the command's module, for example `experiments.view`; `--help` shows it, messages its last part.
      arguments: the command line; None takes the process's own.
      expand: makes the words that are parsed of those on the command line, for example of a file that they name.

    Raises:
      SystemExit: with code 2 after one line on stderr where the user can mend the cause, 130 after Ctrl-C.
    """
    name = module.rpartition(".")[2]
    try:
        options = _parse(options_type, module, expand(sys.argv[1:] if arguments is None else arguments))
        _keep_compiled_programs()
        body(options)
    except (UserError, ScenarioError) as error:
        _fail(name, str(error))
    except OSError as error:
        _fail(name, f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except KeyboardInterrupt:
        print(f"{name}: stopped", file=sys.stderr)
        raise SystemExit(130) from None


def _fail(name: str, message: str) -> NoReturn:
    print(f"{name}: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(2) from None


def _parse(options_type: type[Options], module: str, arguments: Sequence[str]) -> Options:
    try:
        import tyro
    except ImportError:
        raise UserError("the commands need tyro, which is not installed; install jaxfrenet[experiments]") from None
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(options_type, prog=f"python -m {module}", args=arguments)
    except SystemExit as stop:
        if not stop.code:
            raise
        raise UserError(_without_box(complaint.getvalue()) + " (--help lists the options)") from None


def _without_box(text: str) -> str:
    """The first paragraph of a message that is framed with lines, as one line."""
    words = []
    for line in text.splitlines()[1:]:
        content = line.strip(" │")
        if content.startswith(("─", "╰")):
            break
        words += content.split()
    return " ".join(words)


def _keep_compiled_programs() -> None:
    """Keep compiled programs between runs, in `JAX_COMPILATION_CACHE_DIR` or the user's cache folder."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(caches / "jaxfrenet" / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def prepare_folder(folder: Path) -> Path:
    """Create a folder for results and make sure that it can be written to.

    Raises:
      UserError: it is a file, lies in one, or cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (FileExistsError, NotADirectoryError):
        raise UserError(f"{folder}: is not a folder; name another one with --out") from None
    except OSError as error:
        raise UserError(f"{folder}: {error.strerror}; name another folder with --out") from None


def print_table(rows: Sequence[tuple[str, Any]], title: str) -> None:
    """Print names and values in two columns on stdout."""
    width = max(len(name) for name, _ in rows)
    print(title)
    for name, value in rows:
        print(f"  {name:<{width}}  {value:>10}")


def spelled(options: Any, module: str, without: Collection[str] = ()) -> str:
    """The command that has these options, without those that have their default values.

    Args:
      options: a dataclass.
      module: the command's module.
      without: fields that are left out.
    """
    words: list[str] = []
    for field in fields(options):
        value = getattr(options, field.name)
        if field.name not in without and value != field.default:
            words += option_words(field.name, value)
    return f"python -m {module} {shlex.join(words)}".strip()


def option_words(name: str, value: Any) -> list[str]:
    """An option as words of a command line."""
    flag = name.replace("_", "-")
    if isinstance(value, bool):
        return [f"--{flag}" if value else f"--no-{flag}"]
    values = map(str, value) if isinstance(value, tuple | list) else [str(value)]
    return [f"--{flag}", *values]
