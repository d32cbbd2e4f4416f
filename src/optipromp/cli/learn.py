"""``optipromp learn``: demonstrations in, a movement primitive out."""

from pathlib import Path
from typing import Annotated

import typer

from optipromp.cli.console import OK, command, print_json, stdout, waiting


@command()
def learn(
    demonstrations: Annotated[
        Path, typer.Argument(metavar="DEMOS", help="NPZ, CSV, or a folder of CSVs.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the primitive goes (.npz).")],
    em: Annotated[
        bool,
        typer.Option("--em", help="Expectation-maximisation: for partial or uneven recordings."),
    ] = False,
    basis: Annotated[int, typer.Option(help="Number of basis functions.")] = 5,
    width: Annotated[
        float, typer.Option(help="Width of a basis function; larger is narrower.")
    ] = 4,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document and nothing else.")
    ] = False,
) -> int:
    """Learn a movement primitive, for plan --demonstrations.

    [bold]Examples[/bold]

    \b
    optipromp learn recorded.npz --out reach.npz
    optipromp learn recordings/ --out reach.npz --em --basis 8
    """
    from optipromp.promp import Basis, fit, fit_em, load_demonstrations

    with waiting("learning ..."):
        recorded = load_demonstrations(demonstrations)
        shape = Basis(count=basis, width=width)
        promp = (fit_em if em else fit)(recorded, shape)
    promp.save(out)
    samples = sum(len(item.times) for item in recorded)
    if as_json:
        print_json(
            {
                "status": "success",
                "message": "",
                "file": str(out),
                "demonstrations": len(recorded),
                "samples": samples,
                "joints": promp.joint_names,
                "basis": basis,
                "width": width,
                "method": "em" if em else "ridge",
            }
        )
    else:
        stdout().print(
            f"learnt {len(promp.joint_names)} joints from {len(recorded)} demonstrations "
            f"({samples} samples) with {basis} basis functions a joint; wrote {out}"
        )
    return OK
