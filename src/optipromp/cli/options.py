"""The options that several commands have."""

from pathlib import Path
from typing import Annotated, Literal

import typer

Planner = Literal["promp", "i-promp", "opti-promp"]
Strategy = Literal["joint", "sequential"]
Constraints = Literal["push-model", "paper"]
Preset = Literal["cluster", "side-clusters", "table-top", "mixed", "shelf"]

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Seed = Annotated[int, typer.Option(min=0, help="Same seed, same outcome.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes; one a core if left out.")]
ChosenStrategy = Annotated[
    Strategy,
    typer.Option(help="Of opti-promp. joint: one solve; sequential: the paper's two stages."),
]
Recorded = Annotated[
    Path | None,
    typer.Option(help="NPZ, CSV or a folder of CSVs to learn from, or what 'learn' wrote."),
]
