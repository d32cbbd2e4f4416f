"""Modules that were in this package until 0.3.0. Their old names are refused."""

from collections.abc import Sequence
from types import ModuleType

NOW = {
    "control": "%_loop.control",
    "guard": "%_loop.guard",
    "lerobot": "%_loop.lerobot",
    "perception": "%_eyes",
    "ros": "%_ros",
    "laboratory": "%_sim, %_bench.experiments or %_paper",
    "bench": "%_bench",
    "looks.page": "%_page",
    "looks.viewer.notebook": "%_page.notebook",
    "cli.simulate": "%_sim.commands.simulate",
    "cli.generate": "%_sim.commands.generate",
    "cli.measure_crop": "%_sim.commands.measure_crop",
    "cli.see": "%_eyes.commands.see",
    "cli.calibrate": "%_eyes.commands.calibrate",
    "cli.ros_node": "%_ros.commands.ros_node",
    "cli.view": "%_page.commands.view",
    "cli.scenarios": "%_paper.commands.scenarios",
    "cli.study": "%_bench.commands.bench",
    "cli.bench": "%_bench.commands.bench",
    "cli.episodes": "%_bench.commands.episodes",
    "core.scenes.values": "%.core.scenes.pose",
}
"""The new names, with ``%`` for optipromp, by the old ones in it."""


class Moved:
    """The last finder of ``sys.meta_path``: it tells the new name of an old one."""

    @classmethod
    def find_spec(
        cls, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> None:
        """Refuse an old name, with ImportError; of others nothing is known."""
        top, _, inside = name.partition(".")
        if top == "optipromp" and inside in NOW:
            raise ImportError(f"{name} is now {NOW[inside].replace('%', top)}", name=name)
