"""An arm of six joints."""

SIX = (  # joint axis, length of the link beyond it [m]
    ("0 0 1", 0.20), ("0 1 0", 0.40), ("0 1 0", 0.35), ("0 1 0", 0.10), ("0 0 1", 0.08),
    ("0 1 0", 0.06),
)  # fmt: skip


def six(reach: float = 1.0, more: str = "") -> str:
    """An arm of six joints whose links are ``reach`` times as long, and ``more`` elements."""
    parts, parent, height = ['<link name="base"/>'], "base", 0.15
    for k, (axis, length) in enumerate(SIX):
        length *= reach
        parts.append(
            f'<link name="l{k}"><inertial><mass value="1.5"/></inertial><collision><origin '
            f'xyz="0 0 {length / 2}"/><geometry><capsule radius="0.04" length="{length / 2}"/>'
            f'</geometry></collision></link><joint name="j{k}" type="revolute"><parent '
            f'link="{parent}"/><child link="l{k}"/><origin xyz="0 0 {height}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" velocity="2" effort="80"/></joint>'
        )
        parent, height = f"l{k}", length
    parts.append(
        f'<link name="tool0"/><joint name="mount" type="fixed"><parent link="{parent}"/>'
        f'<child link="tool0"/><origin xyz="0 0 {height}"/></joint>'
    )
    return f'<robot name="six">{"".join(parts)}{more}</robot>'
