"""Groups of an SRDF."""


def groups(*bodies: str, name: str = "r") -> str:
    return f'<robot name="{name}">{"".join(bodies)}</robot>'


def along(name: str, base: str, tip: str) -> str:
    return f'<group name="{name}"><chain base_link="{base}" tip_link="{tip}"/></group>'
