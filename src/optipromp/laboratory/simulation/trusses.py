"""The chains of stems, and the torques at the joints of a truss that carry what hangs on it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.objects import SceneObject


class StemChain(NamedTuple):
    """A stem as a chain of N pieces."""

    nodes: FloatArray  # (N+1, 3) joints and the end at the fruit, root first [m]
    masses: FloatArray  # (N,) of the pieces [kg]
    fruit: float  # mass of the fruit [kg]
    center: FloatArray  # (3,) of the fruit [m]
    parent: str | None  # id of the object whose stem it grows from; None: it is rooted in the world
    link: int  # piece of that stem from which it grows

    @property
    def middles(self) -> FloatArray:
        """(N, 3) of the pieces [m]."""
        return 0.5 * (self.nodes[:-1] + self.nodes[1:])

    def bowed(self, bow: FloatArray) -> Self:
        """The chain along half a sine wave, whose middle is off the line by ``bow`` (3,) [m]."""
        gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.nodes, axis=0), axis=1)))
        off = np.sin(np.pi * gone / gone[-1])
        off[-1] = 0.0
        return self._replace(nodes=self.nodes + off[:, None] * bow)


def holding(
    nodes: FloatArray, points: FloatArray, masses: FloatArray, gravity: FloatArray, last: int
) -> FloatArray:
    """Torques (N, 3) at the joints up to ``last`` that carry ``masses`` at ``points`` [N m]."""
    beyond = points[None] - nodes[: last + 1, None]
    out = np.zeros((len(nodes) - 1, 3))
    out[: last + 1] = -np.cross(beyond, (masses[:, None] * gravity)[None]).sum(axis=1)
    return out


def carried(
    chains: Mapping[str, StemChain], gravity: FloatArray
) -> tuple[dict[str, FloatArray], dict[str, dict[str, FloatArray]]]:
    """Torques (N, 3) at the joints of the stems that carry others [N m].

    ``chains``: of all stems, by the ids of their fruits. ``gravity``: (3,) [m/s²].

    Returns: The torques that carry the stems which grow from a stem, by the id of that stem's
    fruit. The torques that carry each fruit, by its id and by the id of the carrying stem's fruit.
    """
    stems: dict[str, FloatArray] = {}
    fruits: dict[str, dict[str, FloatArray]] = {}
    for name, chain in chains.items():
        at = chain
        while at.parent is not None:
            below = chains[at.parent]
            own = holding(below.nodes, chain.middles, chain.masses, gravity, at.link)
            stems[at.parent] = stems.get(at.parent, 0.0) + own
            fruits.setdefault(name, {})[at.parent] = holding(
                below.nodes, chain.center[None], np.array([chain.fruit]), gravity, at.link
            )
            at = below
    return stems, fruits


def tops(objects: Sequence[SceneObject]) -> dict[str, str]:
    """The id of the object whose stem holds the whole truss, by id of each fruit on a truss."""
    above = {
        item.id: item.stem.parent
        for item in objects
        if item.stem is not None and item.stem.parent is not None
    }
    out = {}
    for name in above:
        top = name
        while top in above:
            top = above[top]
        out[name] = out[top] = top
    return out
