"""MJCF of small mechanisms with closed loops and followers, for tests."""

from __future__ import annotations

from lieednn_sim._mujoco import mujoco

MODEL = """<mujoco><compiler angle="radian"/><option jacobian="{2}"/><default><geom size=".02" mass="1"/></default>
<worldbody>{0}</worldbody><equality>{1}</equality></mujoco>"""


def compiled(bodies: str, equalities: str, jacobian: str = "dense") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MODEL.format(bodies, equalities, jacobian))


def body(name: str, joint: str, inside: str = "", pos: str = "0 0 0") -> str:
    return f'<body name="{name}" pos="{pos}">{joint}<geom/>{inside}</body>'


def hinge(name: str, axis: str = "0 -1 0") -> str:
    return f'<joint name="{name}" axis="{axis}"/>'


def slide(name: str, axis: str = "1 0 0", more: str = "") -> str:
    return f'<joint name="{name}" type="slide" axis="{axis}" {more}/>'


def site(name: str, pos: str) -> str:
    return f'<site name="{name}" pos="{pos}"/>'


def connect(one: str, other: str) -> str:
    return f'<connect site1="{one}" site2="{other}"/>'


def tied(follower: str, leader: str, coefficients: str) -> str:
    return f'<joint joint1="{follower}" joint2="{leader}" polycoef="{coefficients}"/>'


def four_bar(crank: float, coupler: float, rocker: float) -> tuple[str, str]:
    """Bodies and equalities of a planar four-bar linkage, 1 m between its fixed hinges."""
    tip = site("tip", f"{coupler} 0 0")
    left = body("crank", hinge("crank"), body("coupler", hinge("coupler"), tip, f"{crank} 0 0"))
    return left + body("rocker", hinge("rocker"), site("end", f"{rocker} 0 0"), "1 0 0"), connect("tip", "end")


# A crane whose boom is lifted by a cylinder, with the loop of a gripper that it does not move in itself.
_GRIPPER = body("g1", hinge("g1"), body("g2", hinge("g2"), site("g", ".1 0 .1"), ".1 0 0")) + site("palm", ".1 0 .1")
_BOOM = site("lug", "1.5 0 -.1") + body("jib", slide("extend"), _GRIPPER, "4 0 0")
_ROD = body("rod", slide("stroke"), site("eye", ".5 0 0"), ".8 0 0")
_LIFTED = body("boom", hinge("luff"), _BOOM, "0 0 2") + body("barrel", hinge("swivel"), _ROD, ".3 0 .8")
CRANE = body("post", hinge("slew", "0 0 1"), _LIFTED), connect("lug", "eye") + connect("g", "palm")
