"""The entities whose contacts are counted, and the pairs that can touch."""

from dataclasses import dataclass
from enum import IntFlag
from typing import Literal

EntityKind = Literal["link", "tool", "fruit", "thing", "stem", "static", "avoid"]


@dataclass(frozen=True)
class Entity:
    """A robot link, the tool, a fruit, a stem or an object: its contacts are counted together."""

    kind: EntityKind  # of the entity
    name: str  # of the link, or the object's id (a stem's is its fruit's)
    distal: bool = False  # whether it is the last link or the tool, which are not in B_d

    @property
    def label(self) -> str:
        """Unique among the entities of a world."""
        return f"{self.kind}:{self.name}"


class Layer(IntFlag):
    """Bits of MuJoCo's contype."""

    ROBOT = 1
    FRUIT = 2
    STEM = 4
    STATIC = 8
    AVOID = 16


NOBODY = -1
"""Index of an entity that no contact is counted for: the floor's."""


def layers(kind: EntityKind | Literal["foot", "floor"]) -> dict[str, int]:
    """``contype`` and ``conaffinity`` of a kind.

    The robot touches everything but itself. Fruits touch everything. Stems touch the robot and
    fruits, but neither each other nor static objects. The foot of a can touches only the object
    that it stands on, the floor only fruits that have fallen.
    """
    meets_movers = int(Layer.ROBOT | Layer.FRUIT)
    match kind:
        case "link" | "tool":
            return {"contype": int(Layer.ROBOT), "conaffinity": 0}
        case "fruit" | "thing":
            return {"contype": int(Layer.FRUIT), "conaffinity": meets_movers}
        case "foot":
            return {"contype": 0, "conaffinity": int(Layer.STATIC)}
        case "floor":
            return {"contype": 0, "conaffinity": int(Layer.FRUIT)}
        case "stem":
            return {"contype": int(Layer.STEM), "conaffinity": meets_movers}
        case "static":
            return {"contype": int(Layer.STATIC), "conaffinity": meets_movers}
    return {"contype": int(Layer.AVOID), "conaffinity": meets_movers}
