"""Entries of the benchmark's tests, in a module of their own: each works in another process."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp import Picked, PlanOptions, Scene, Trajectory, plan, plan_pick
from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.scene import bare_robot
from optipromp_bench.episode import Observation

HERE = __name__ if __name__ != "__main__" else "tests.bench.entrants"


def entry(kind: type) -> str:
    return f"{HERE}:{kind.__name__}"


def still(scene: Scene, seconds: float = 1.0, rows: int = 2) -> Trajectory:
    """A motion that stays at the scene's start."""
    robot, start = bare_robot(scene), np.asarray(scene.start)
    q = np.tile(start, (rows, 1))
    zero = np.zeros_like(q)
    return Trajectory(np.linspace(0.0, seconds, rows), q, zero, zero, robot.joint_names)


class Still:
    """Stay at the start."""

    def plan(self, scene: Scene, seed: int) -> Trajectory:
        return still(scene)


class Broken:
    """An entry with a defect."""

    def plan(self, scene: Scene, seed: int) -> None:
        raise ZeroDivisionError("a defect")


class Ours:
    """The default planner."""

    def plan(self, scene: Scene, seed: int) -> Picked:
        return plan_pick(scene, seed=seed, options=PlanOptions(risk=0.1))


class Hasty:
    """The default planner's motion in a third of its time, which no arm follows."""

    def plan(self, scene: Scene, seed: int) -> Trajectory:
        own = plan(scene, seed=seed).trajectory
        q, v, a = own.rows()
        return Trajectory(own.times / 3.0, q, 3.0 * v, 9.0 * a, own.joint_names)


class Follower:
    """The default planner's motion, followed by velocities."""

    def reset(self, scene: Scene, seed: int) -> None:
        self.motion = plan(scene, seed=seed).trajectory

    def act(self, seen: Observation) -> FloatArray:
        q, v, _ = (row[0] for row in self.motion.sample(min(seen.time, self.motion.duration)))
        return np.asarray(v + 2.0 * (q - seen.q))


class Seer:
    """See, then plan."""

    def plan(self, picture: Any, known: Scene, seed: int) -> Trajectory:
        from optipromp_eyes.eyes import look_at, seen_scene

        scene, _ = seen_scene([look_at(picture, up=known.up)], known)
        return plan(scene, seed=seed).trajectory


class Spy:
    """Tell all that an entry knows, as its refusal's cause."""

    def plan(self, scene: Scene, seed: int) -> str:
        told = [scene.name, str(seed), str(Path.cwd()), *sys.argv, *os.environ.values()]
        told += [str(v) for v in vars(scene).values() if not isinstance(v, tuple)]
        raise ValueError("\n".join(told))


class Thief:
    """Read the judge's memory and its arguments, and leave a process behind."""

    def plan(self, scene: Scene, seed: int) -> None:
        left = subprocess.Popen(["sleep", "1000"], start_new_session=True).pid
        try:
            Path(f"/proc/{os.getppid()}/mem").open("rb").close()
            told = "was read"
        except OSError as error:
            told = str(error)
        words = Path(f"/proc/{os.getppid()}/cmdline").read_text().rstrip("\0")
        raise ValueError(f"{left} {told} {words}")


class Patcher:
    """Change the judge's verdict, in this process."""

    def plan(self, scene: Scene, seed: int) -> Trajectory:
        import optipromp_bench.running as running

        row = running._row
        running._row = lambda *told: replace(row(*told), result="clean")
        return still(scene)


HOWS = (
    "exit", "interrupt", "surrogate", "text", "long", "rows", "begin", "names", "abort", "hang",
)  # fmt: skip


class Wrong:
    """Do wrong in the way of :data:`HOWS` that the seed tells."""

    def plan(self, scene: Scene, seed: int) -> Any:
        own = still(scene)
        t, q, zero, names = own.times, own.positions, 0.0 * own.positions, own.joint_names
        match HOWS[seed % len(HOWS)]:
            case "exit":
                sys.exit(0)
            case "interrupt":
                raise KeyboardInterrupt
            case "surrogate":
                raise ValueError("bad \ud800 letter\x1b[2J\n" + "a" * 100_000)
            case "text":
                return "a text"
            case "long":
                return still(scene, 61.0)
            case "rows":
                return still(scene, 50.0, 100_001)
            case "begin":
                return Trajectory(t, q + 0.1, zero, zero, names)
            case "names":
                return Trajectory(t, q, zero, zero, names[::-1])
            case "abort":
                os._exit(3)
        return time.sleep(1000.0)


class Aborts:
    """End the process in every scene."""

    def plan(self, scene: Scene, seed: int) -> None:
        os._exit(3)
