"""``optipromp episodes``: what an expert does, for learners."""

from pathlib import Path

from optipromp.cli.command import Report, command
from optipromp.cli.console import Cluster, Workers, progress_bar, say_if_compiling
from optipromp.core.errors import check_one_of


@command()
def episodes(
    out: Path,
    count: int = 100,
    form: str = "minari",
    preset: str = "cluster,field",
    seed: int | None = None,
    condition: str = "none",
    keep: str = "clean",
    pictures: bool = False,
    name: str = "optipromp/pick/expert-v0",
    policy: str = "",
    guarded: bool = False,
    workers: Workers = None,
    ray: Cluster = None,
) -> Report:
    """Write episodes of our planner as a policy, at 50 Hz, for learners.

    State episodes take about a second and a half each on one core.

    Examples:
        optipromp episodes --count 1000 --out data
        optipromp episodes --count 50 --format lerobot --pictures --out data
        optipromp episodes --policy mine:Policy --guarded --keep all --out data

    Args:
        out (DIR): Of the dataset.
        count (1..): Episodes to keep.
        form (--format NAME): minari or lerobot (version 3.0).
        preset (NAMES): Of the scenes, in turn, separated by commas.
        seed: Of the first scene.
        condition (NAME): What moves and is seen wrongly; as in bench run.
        keep (WHICH): clean: successes alone; or all.
        pictures: With those of the camera in the tool's mouth.
        name (ID): Of a Minari dataset.
        policy (NAME): What acts in place of our planner, as in bench run.
        guarded: Actions pass the guard; where it acts, its action is the label.
    """
    from optipromp_bench import episodes as bench
    from optipromp_sim.generate import PRESETS
    from optipromp_sim.situations import CONDITIONS

    presets = tuple(filter(None, preset.split(",")))
    given = [("format", form, bench.FORMATS), ("keep", keep, ("clean", "all"))]
    given += [("condition", condition, tuple(CONDITIONS))]
    given += [("preset", each, tuple(PRESETS)) for each in presets or ("",)]
    for what, value, valid in given:
        check_one_of(what, value, valid)
    bench.check_place(form, out, name)  # type: ignore[arg-type]
    first = bench.FIRST if seed is None else seed
    asks = [
        bench.EpisodeAsk(presets[k % len(presets)], first + k, condition, pictures, policy, guarded)
        for k in range(2 * count + 20)
    ]
    say_if_compiling()
    with progress_bar(20) as say:
        made = bench.collected(asks, count, keep=keep, workers=workers, ray=ray, progress=say)  # type: ignore[arg-type]
    bench.write_minari(made, out, name) if form == "minari" else bench.write_lerobot(made, out)
    steps, clean = sum(len(each.rewards) for each in made), sum(each.success for each in made)
    document = {
        "format": form, "out": str(out), "episodes": len(made), "steps": steps, "clean": clean,
        "seeds": [each.ask.seed for each in made],
    }  # fmt: skip
    words = f"wrote {len(made)} episodes, {steps} steps, {clean} of them clean, to {out}"
    return Report(document, [words])
