from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

README = Path(__file__).parents[2] / "README.md"


def test_the_python_example_runs(capsys):
    text = README.read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})
    said = capsys.readouterr().out
    assert re.search(r"^\d+ of 800 trajectories can be driven$", said, flags=re.MULTILINE)
    assert re.search(
        r"^(GOAL_REACHED_\w+|COLLISION_\w+|INFEASIBLE|TIMEOUT|PAST_GOAL) after \d+ steps$", said, re.MULTILINE
    )


def test_everything_it_shows_exists():
    text = README.read_text(encoding="utf-8")
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", text)
    assert pictures
    for picture in pictures:
        assert (README.parent / picture).stat().st_size < (2_500_000 if picture.endswith(".gif") else 400_000)
    modules = set(re.findall(r"python -m ((?:experiments|scenarios)\.\w+)", text))
    assert modules and all(find_spec(module) for module in modules)
    rooms = re.findall(r"^\| `(\w+)/`", text, flags=re.MULTILINE)
    assert rooms and all((README.parent / room).is_dir() for room in rooms)
