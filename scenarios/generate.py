"""Write generated scenarios to files: CommonRoad documents, or one `.npz` set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from scenarios.collection import ScenarioSet
from scenarios.command_line import prepare_folder, run_command
from scenarios.families import Draw, documents, generate
from scenarios.files import written_whole
from scenarios.storage import save_npz


@dataclass(frozen=True)
class GenerateOptions:
    """Write generated scenarios to files."""

    family: str = "tjunction"
    """Kind of scenario: tjunction, crossing or highway."""
    preset: str = "default"
    """What they are drawn from: default, hard or, for T-junctions, commonroad (like CommonRoad's own)."""
    count: int = 16
    """How many scenarios to write."""
    seed: int = 0
    """Seed of everything random; scenario number i of a seed is always the same one."""
    format: Literal["commonroad", "npz"] = "commonroad"
    """`commonroad` writes a CommonRoad 2020a file per scenario, `npz` one set that every command reads fast."""
    out: Path = Path("runs/generate")
    """Folder for the files."""


def write_generated(options: GenerateOptions) -> None:
    """Write the scenarios that the options ask for, and print how many and where they are."""
    draw = Draw(options.count, options.seed, options.family, options.preset).checked()
    folder = prepare_folder(options.out)
    if options.format == "npz":
        target = folder / f"{draw.family}-{draw.preset}-{draw.seed}.npz"
        save_npz(target, _generated(draw))
    else:
        target = folder
        _write_documents(draw, folder)
    print(f"{draw.count} scenarios written to {target}")


def _generated(draw: Draw) -> ScenarioSet:
    from tqdm import tqdm

    with tqdm(desc="generating", total=draw.count, unit=" scenarios", delay=5.0) as bar:

        def report(done: int, total: int) -> None:
            bar.update(done - bar.n)

        return generate(draw, report)


def _write_documents(draw: Draw, folder: Path) -> None:
    from tqdm import tqdm

    for name, text in tqdm(documents(draw), "generating", draw.count, unit=" scenarios", delay=5.0):
        with written_whole(folder / f"{name}.xml") as file:
            file.write(text)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(GenerateOptions, write_generated, "scenarios.generate", arguments)


if __name__ == "__main__":
    main()
