"""Balls, and arms of one joint."""


def joint(name: str, kind: str, parent: str, child: str, axis: str, limit: str) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/>{limit}</joint>'
    )


def ball(name: str, radius: float, at: str = "0 0 0") -> str:
    return (
        f'<link name="{name}"><collision><origin xyz="{at}"/><geometry>'
        f'<sphere radius="{radius}"/></geometry></collision></link>'
    )
