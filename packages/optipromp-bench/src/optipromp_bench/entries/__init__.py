"""The entries of this project, by name (``optipromp bench list``).

Other people's methods (``CLASSIC``, ``LEARNT``) are in the clone alone, in ``benchmarks/entries``.
"""

from collections.abc import Mapping
from typing import NamedTuple


class Contender(NamedTuple):
    """An entry: where its class is, what it does, and its track."""

    spec: str
    text: str
    track: str = "plan"


PLANNERS: Mapping[str, str] = {
    "straight": "straight at the target; nothing is known of pushes",
    "chomp": "CHOMP from a ProMP (the related work on tomatoes)",
    "drift": "the paper's rule: away from each stem",
    "i-promp": "the paper's first method",
    "i-promp-guard": "the same with a mouth closed while it pushes",
    "paper": "OptI-ProMP, sequential, as the paper has it",
    "obstacles": "ours with every neighbour an obstacle",
    "opti-promp": "ours",
}
CLASSIC: Mapping[str, Contender] = {
    name: Contender(f"benchmarks.entries.{module}:{kind}", text)
    for name, module, kind, text in (
        ("rrt", "classic", "Rrt", "RRT-Connect (OMPL); last link and tool may touch fruits"),
        ("push-aside", "classic", "PushAside", "pushes from beside each fruit (Xiong 2019)"),
        ("receding", "sampling", "Receding", "receding-horizon pushes (Dogar) in our push model"),
        ("mppi", "sampling", "Mppi", "MPPI on our push model"),
    )
}
LEARNT: Mapping[str, Contender] = {
    name: Contender(f"benchmarks.entries.learnt:{kind}", text, track)
    for name, kind, text, track in (
        ("set", "SetNetwork", "a network's path from the scene, trained on our plans", "plan"),
        ("clone", "Cloned", "behaviour cloning of our plans' steps", "policy"),
        ("act", "Act", "action chunks by a transformer, cloned from our plans' steps", "policy"),
    )
}
ENTRIES: Mapping[str, Contender] = {
    **{
        name: Contender(f"optipromp_bench.entries.planners:{name.title().replace('-', '')}", text)
        for name, text in PLANNERS.items()
    },
    **CLASSIC,
    **LEARNT,
    "blind": Contender("optipromp_bench.entries.own:Blind", "ours, one plan, blind", "policy"),
    "closed": Contender(
        "optipromp_bench.entries.own:Closed", "ours, the closed loop: look and look again", "policy"
    ),
    "eyes": Contender(
        "optipromp_bench.entries.own:ByEyes", "ours in the scene that one picture shows", "picture"
    ),
}
