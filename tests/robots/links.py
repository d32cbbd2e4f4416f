"""Links and joints of a URDF."""

from collections.abc import Callable
from pathlib import Path

Writer = Callable[..., Path]  # of the fixtures ``write`` and ``urdf``
BALL = '<collision><geometry><sphere radius="0.02"/></geometry></collision>'


def joint(
    name: str,
    parent: str,
    child: str,
    kind: str = "revolute",
    limit: str = '<limit lower="-1" upper="1" velocity="2"/>',
    axis: str = '<axis xyz="0 0 1"/>',
    origin: str = '<origin xyz="0.1 0 0.2" rpy="0.1 0.2 0.3"/>',
    more: str = "",
) -> str:
    """A <joint> element."""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{origin}{axis}{limit}{more}</joint>'
