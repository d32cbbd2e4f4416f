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

SceneOrFolder = Annotated[
    str,
    typer.Argument(
        metavar="SCENE|DIR",
        help="A scene file, a built-in scene's name, or a folder of scene files.",
    ),
]
ChosenPlanner = Annotated[
    Planner,
    typer.Option(help="promp: as learnt; i-promp: pushing by geometry; opti-promp: optimised."),
]
Duration = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Of the motion; the shortest within limits if left out."),
]
ChosenConstraints = Annotated[
    Constraints,
    typer.Option(help="push-model: least predicted harm; paper: the paper's constraints 1-4."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Any other setting, as often as you like; 'optipromp list' names them.",
    ),
]
Timeout = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Give up planning after this long.")
]
PlanFolder = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Leave plan.json, trajectory.csv and .npz, and figures; of a folder's scenes, "
        "in a folder each.",
    ),
]
Figures = Annotated[
    bool | None,
    typer.Option(
        "--figures/--no-figures",
        help="Draw figures into --out; by default for one scene, not for a folder's.",
        show_default=False,
    ),
]
