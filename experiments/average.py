"""Average policies of one training run: the mean of their networks is steadier than any of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

import ppo
from scenarios.command_line import UserError, run_command

SAME = "observation_names", "action_names", "adjustments"
"""What policies must have in common."""


@dataclass(frozen=True)
class AverageOptions:
    """Average policies of one run, as `experiments.train --keep-policies` keeps them; writes a policy like any other.

    Learning from few risky situations is noisy, and the policies after one validation and the next err in different
    directions. How good the average is, `experiments.evaluate --policy` tells.
    """

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY...")]
    """Folders of the policies."""
    out: Path = Path("runs/average")
    """Folder for the average."""


def average(options: AverageOptions) -> None:
    """Read the policies and write their average."""
    try:
        read = [ppo.load_policy(folder) for folder in options.policies]
        mean = ppo.average_policies([policy for policy, _ in read])
    except ppo.PolicyError as error:
        raise UserError(str(error)) from None
    first = read[0][1]
    for folder, (_, about) in zip(options.policies, read, strict=True):
        for name in SAME:
            if about.get(name) != first.get(name):
                raise UserError(f"{folder}: has other {name} than {options.policies[0]}; name policies of one run")
    about = {name: value for name, value in read[-1][1].items() if name not in ("steps", "validation_return")}
    steps = [about.get("steps") for _, about in read]
    ppo.save_policy(options.out, mean, about | {"averaged_steps": steps})
    print(f"average of {len(read)} policies written to {options.out}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(AverageOptions, average, "experiments.average", arguments)


if __name__ == "__main__":
    main()
