"""`python -m scenarios.generate`: generated scenarios in files."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import scenarios
from scenarios import generate
from scenarios.batching import leaves_of
from scenarios.families import FAMILIES, Draw
from scenarios.families import generate as generated_set

TWO = ["--count", "2", "--seed", "0"]


def complaint(arguments, capsys) -> str:
    with pytest.raises(SystemExit) as stop:
        generate.main(arguments)
    assert stop.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("generate: ")
    return lines[0]


def test_one_commonroad_file_per_scenario(tmp_path, capsys):
    pytest.importorskip("commonroad")
    generate.main([*TWO, "--out", str(tmp_path / "new" / "folder")])
    draw = Draw(2)
    assert capsys.readouterr().out == f"2 scenarios written to {tmp_path / 'new' / 'folder'}\n"
    files = sorted(path.name for path in (tmp_path / "new" / "folder").iterdir())
    assert files == [f"{draw.name(0)}.xml", f"{draw.name(1)}.xml"]
    read = scenarios.load_set([tmp_path])
    assert not read.skipped
    for one, wanted in zip(read.scenarios, generated_set(draw).scenarios, strict=True):
        np.testing.assert_allclose(one.initial_state.speed, wanted.initial_state.speed, rtol=1e-5)


def test_an_npz_set_holds_the_same_arrays(tmp_path, capsys):
    generate.main([*TWO, "--format", "npz", "--out", str(tmp_path)])
    path = tmp_path / "tjunction-default-0.npz"
    assert capsys.readouterr().out == f"2 scenarios written to {path}\n"
    read, wanted = scenarios.load_npz(path), generated_set(Draw(2))
    assert read.infos == wanted.infos
    for one, other in zip(read.scenarios, wanted.scenarios, strict=True):
        assert all(np.array_equal(leaf, leaves_of(other)[name]) for name, leaf in leaves_of(one).items())


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--family", "roundabout"], "tjunction"),
        (["--preset", "mild"], "default, commonroad, hard"),
        (["--count", "0"], "at least 1"),
        (["--count", "few"], "few"),
        (["--seed", "-1"], "-1"),
        (["--format", "csv"], "csv"),
        (["--scenarios", "builtin"], "--scenarios"),
    ],
)
def test_bad_option(arguments, says, tmp_path, capsys):
    out = tmp_path / "out"
    assert says in complaint([*arguments, "--out", str(out)], capsys)
    assert not out.exists()


def test_out_is_a_file(tmp_path, capsys):
    out = tmp_path / "out"
    out.write_text("mine")
    for folder in (out, out / "deeper"):
        assert str(out) in complaint([*TWO, "--out", str(folder)], capsys)
    assert out.read_text() == "mine"


def test_without_commonroad_io(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "commonroad.common.file_writer", None)
    assert "install jaxfrenet[commonroad]" in complaint([*TWO, "--out", str(tmp_path)], capsys)
    assert not list(tmp_path.iterdir())


def test_without_tyro(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "tyro", None)
    assert "install jaxfrenet[experiments]" in complaint([*TWO, "--out", str(tmp_path)], capsys)


def test_help_names_families_and_presets(capsys):
    with pytest.raises(SystemExit) as stop:
        generate.main(["--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    assert "python -m scenarios.generate" in shown
    assert all(name in shown for family in FAMILIES for name in (family, *FAMILIES[family].presets))
