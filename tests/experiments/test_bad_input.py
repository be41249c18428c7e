from __future__ import annotations

import pytest

from experiments import compare, evaluate, gallery, view


def complaint(main, arguments, capsys) -> str:
    """What a command that must fail says; exactly one line."""
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--weights", "predicton=3"], "predicton"),
        (["--weights", "prediction=abc"], "abc"),
        (["--weights", "prediction=-1"], "-1"),
        (["--weights", "prediction=nan"], "nan"),
        (["--weights", "prediction=inf"], "inf"),
        (["--weights", "prediction"], "prediction"),
        (["--weights", "prediction=1", "prediction=2"], "twice"),
        (["--curvature-rate-limit", "-1"], "-1"),
        (["--curvature-rate-limit", "nan"], "nan"),
        (["--planner", "best"], "best"),
        (["--predictor", "crystal_ball"], "crystal_ball"),
        (["--no-such-option"], "--no-such-option"),
        (["--batch", "0"], "--batch"),
        (["--batch", "many"], "many"),
        (["--scenarios", "builtin", "--planning-problem", "424242"], "424242"),
        (["--planning-problem", "424242"], "--scenarios"),
        (["--scenarios"], "--scenarios"),
        (["--scenarios", "builtin", "--generate", "3"], "--generate"),
        (["--scenarios", "builtin", "--family", "highway"], "--family"),
        (["--generate", "0"], "at least 1"),
        (["--generate", "-3"], "at least 1"),
        (["--generate", "many"], "many"),
        (["--generator-seed", "-1"], "-1"),
        (["--family", "roundabout"], "tjunction"),
        (["--preset", "mild"], "default, commonroad, hard"),
    ],
)
def test_bad_option(arguments, says, tmp_path, capsys):
    out = tmp_path / "out"
    assert says in complaint(evaluate.main, [*arguments, "--out", str(out)], capsys)
    assert not out.exists()


@pytest.mark.parametrize("main", [view.main, gallery.main, compare.main], ids=["view", "gallery", "compare"])
@pytest.mark.parametrize("arguments, says", [(["--generate", "0"], "at least 1"), (["--family", "x"], "tjunction")])
def test_nothing_to_generate(main, arguments, says, tmp_path, capsys):
    files = ["--scenarios", "builtin"] if main is compare.main else []
    out = tmp_path / "out"
    assert says in complaint(main, [*files, *arguments, "--out", str(out)], capsys)
    assert not out.exists()


def bad_files(folder):
    """Scenario sources that cannot be read, by what is wrong with them."""
    (folder / "empty_folder").mkdir()
    (folder / "empty.xml").touch()
    (folder / "empty.zip").touch()
    (folder / "empty.tar.xz").touch()
    (folder / "other.xml").write_text("<recipe><step/></recipe>")
    (folder / "text.xml").write_text("no XML at all")
    (folder / "table.npz").write_bytes(b"PK\x03\x04 and no more")
    (folder / "notes.txt").write_text("notes")
    return ["missing.xml", "empty_folder", *(path.name for path in folder.iterdir() if path.is_file())]


COMMANDS = pytest.mark.parametrize(
    "main", [evaluate.main, view.main, gallery.main, compare.main], ids=["evaluate", "view", "gallery", "compare"]
)


@COMMANDS
def test_bad_scenario_sources(main, tmp_path, capsys):
    for name in bad_files(tmp_path):
        out = tmp_path / "out"
        assert name in complaint(main, ["--scenarios", str(tmp_path / name), "--out", str(out)], capsys)
        assert not out.exists()


def test_truncated_file(broken_file, tmp_path, capsys):
    out = tmp_path / "out"
    assert "broken.xml" in complaint(evaluate.main, ["--scenarios", str(broken_file), "--out", str(out)], capsys)


def test_file_without_planning_problem(without_planning_problem, tmp_path, capsys):
    arguments = ["--scenarios", str(without_planning_problem), "--out", str(tmp_path / "out")]
    assert "planning problem" in complaint(evaluate.main, arguments, capsys)


@COMMANDS
def test_out_is_a_file(main, tmp_path, capsys):
    out = tmp_path / "out"
    out.write_text("mine")
    for folder in (out, out / "deeper"):
        assert str(out) in complaint(main, ["--scenarios", "builtin", "--out", str(folder)], capsys)
    assert out.read_text() == "mine"


def test_view_of_an_unknown_name(tmp_path, capsys):
    arguments = ["--scenarios", "builtin", "--name", "nobody", "--out", str(tmp_path / "out")]
    assert "nobody" in complaint(view.main, arguments, capsys)


def test_compare_needs_files(tmp_path, capsys):
    assert "--scenarios" in complaint(compare.main, ["--out", str(tmp_path / "out")], capsys)
