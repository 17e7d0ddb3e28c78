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

# A palletiser: a bar along the upper arm keeps a triangle at the elbow level, and a bar along the forearm the hand.
_FORE = body("hand", hinge("hand", "0 1 0"), site("h", "0 0 .1"), ".6 0 0")
_TRIANGLE = body("bar2", hinge("bar2", "0 1 0"), site("b2", ".6 0 0"), "0 0 .1") + site("t", "-.1 0 0")
_UPPER = body("fore", hinge("elbow", "0 1 0"), _FORE, "0 0 .5")
_UPPER += body("triangle", hinge("triangle", "0 1 0"), _TRIANGLE, "0 0 .5")
_TURRET = body("upper", hinge("shoulder", "0 1 0"), _UPPER)
_TURRET += body("bar1", hinge("bar1", "0 1 0"), site("b1", "0 0 .5"), "-.1 0 0")
PALLETISER = body("turret", hinge("turn", "0 0 1"), _TURRET), connect("b1", "t") + connect("b2", "h")

# A scissor lift: two crossed bars of 1 m, one hinged to the ground and one rolling, and the same under the stage.
_CROSSED = body("b", hinge("cross"), site("foot", ".5 0 0") + site("top", "-.5 0 0"), ".5 0 0") + site("end", "1 0 0")
_STAGE = site("s", "0 0 0") + body("c", slide("roll"), site("u", "0 0 0"))
_PUSHED = body("a", hinge("a"), _CROSSED) + body("roller", slide("push"), site("r", "0 0 0"))
SCISSOR = (
    _PUSHED + body("stage", slide("x") + slide("z", "0 0 1"), _STAGE),
    connect("foot", "r") + connect("top", "s") + connect("end", "u"),
)
