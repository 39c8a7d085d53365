"""Robots for a test: URDFs of a few links."""

LIMIT = '<limit lower="-1.5" upper="2" velocity="2" effort="30"/>'


def link(name: str, mass: float = 1.0, ixx: float = 0.01, shape: str = "") -> str:
    return (
        f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx="{ixx}" iyy="0.01" izz="0.01" ixy="0" '
        f'ixz="0" iyz="0"/></inertial>{shape}</link>'
    )


def joint(name: str, parent: str, child: str, axis: str = "0 1 0", kind: str = "revolute", limit: str = LIMIT) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.3" rpy="0 0 0"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def robot(*parts: str) -> str:
    return f'<robot name="toy">{"".join(parts)}</robot>'
