"""``optipromp measure-crop``: from a ruler and a kitchen scale to a crop."""

from collections.abc import Sequence
from pathlib import Path

from optipromp.cli.command import Report, command
from optipromp.cli.console import grid
from optipromp.core.errors import InvalidRequestError


@command()
def measure_crop(
    measured: list[str], /, *, out: Path, name: str | None = None, like: str = "strawberry"
) -> Report:
    """Make a crop file from measurements with a ruler, a kitchen scale and a phone.

    Of each fruit, in mm: width, length, stem_length, stem_diameter; sag of the tip of its level
    stem under sag_load; swings in a film, from swing_first to swing_last aside. In g: mass,
    sag_load; pull_along and pull_across the stem at which it comes off. All other rows are of the
    crop that yours is like, and stay guesses where they are guesses.

    Examples:
        optipromp measure-crop fruits.csv --like tomato --out my-crop.yaml
        optipromp measure-crop width=31,29,34 length=42,40,45 mass=19,16,24 --out my-crop.yaml
        optipromp bench study presets=cluster vary=crop --crop my-crop.yaml --out guesses

    Args:
        measured (TABLE.csv|NAME=NUMBERS): A column each, whose cells may be empty; or
            width=31,29,34.
        out (FILE.yaml): The crop.
        name: Of the crop; by default that of the file.
        like (CROP): Whose rows stand where nothing was measured.
    """
    from optipromp.core.documents import read_table
    from optipromp.core.scenes.crops import crop_to_dict, load_crop, save_crop
    from optipromp_sim.measuring import measured_crop

    given: dict[str, Sequence[str]] = {}
    for word in measured:
        key, equals, numbers = word.partition("=")
        if equals:
            given[key] = numbers.split(",")
            continue
        table = read_table(Path(word), InvalidRequestError, "width, mass, ...")
        given |= {key: [row[k] for row in table.rows] for k, key in enumerate(table.header)}
    usual = load_crop(like)
    crop = measured_crop(name or out.stem, usual, given)
    save_crop(crop, out)
    mine = {k: v for k, v in crop_to_dict(crop).items() if crop.rows.get(k) != usual.rows.get(k)}
    shown = grid(("row",), ("value", "spread", "unit"))
    for key, row in mine.items():
        shown.add_row(key, f"{crop[key]:.4g}", f"{crop.rows[key].spread:.2g}", row["unit"])
    rest = f"still guesses, of {like}: {', '.join(crop.guesses)}"
    document = {"file": str(out), "name": crop.name, "guesses": crop.guesses, "measured": mine}
    return Report(document, (shown, rest, f"wrote {out}"))
