"""MJCF of small mechanisms with closed loops and followers, and of an arm of all kinds of joints, for tests."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco

MODEL = """<mujoco><compiler angle="radian"/><option jacobian="{2}"/><default><geom size=".02" mass="1"/></default>
<worldbody>{0}</worldbody><equality>{1}</equality></mujoco>"""


# A ball shoulder with a telescope of three coupled stages, a universal joint with an off-axis slide, and two links
# whose slides share one coordinate.
ODD_ARM = """
<mujoco model="odd">
  <compiler angle="radian" autolimits="true"/>
  <default><geom type="sphere" size="0.01" contype="0" conaffinity="0" mass="1"/></default>
  <worldbody>
    <site name="base_frame" pos="0.1 0 0.2" euler="0.3 0 0.1"/>
    <body name="shoulder" pos="0 0 0.4" euler="0.2 0.4 -0.3">
      <joint name="shoulder" type="ball" range="0 2"/><geom/>
      <body name="tube" pos="0 0 0.1">
        <joint name="out1" type="slide" axis="0 0 1" range="0 0.2"/><geom/>
        <body name="tube2" pos="0 0 0.1">
          <joint name="out2" type="slide" axis="0 0 1" range="0 0.2" ref="0.02"/><geom/>
          <body name="tube3" pos="0 0 0.1">
            <joint name="out3" type="slide" axis="0 0 1" range="-0.5 0.5" ref="0.05"/><geom/>
            <site name="link1_frame" pos="0 0 0.1" euler="0 0.5 0"/>
            <body name="cross" pos="0.1 0 0">
              <joint name="yaw" type="hinge" axis="0 0 1" range="-1 1"/><geom/>
              <body name="fork" pos="0 0.05 0">
                <joint name="pitch" type="hinge" axis="0 1 0" range="-1 1.2" ref="0.1"/><geom/>
                <joint name="boom" type="slide" axis="0.8 0 0.6" range="0 0.3"/>
                <site name="link2_frame" pos="0.2 0 0"/>
                <body name="left" pos="0.2 0 0">
                  <joint name="roll" type="hinge" axis="1 0 0" range="-1 1"/>
                  <joint name="left" type="slide" axis="1 0 0" range="0 0.3"/><geom/>
                  <site name="link3_frame"/>
                  <body name="right" pos="0.2 0 0">
                    <joint name="right" type="slide" axis="0 1 0" range="-1 1"/><geom/>
                    <site name="link4_frame"/>
                  </body>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
    <body name="elsewhere"><joint name="wheel" type="hinge" axis="0 0 1"/><geom/></body>
  </worldbody>
  <equality>
    <joint joint1="out2" joint2="out1" polycoef="0.01 1 0 0 0"/>
    <joint joint1="out3" joint2="out2" polycoef="0 -0.5 0 0 0"/>
    <joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/>
  </equality>
</mujoco>
"""


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

# A free tool that an active weld fixes to a hand, beside a table.
TOOL = """<mujoco><worldbody><geom name="table" type="box" pos="0 .45 .44" size=".2 .2 .02"/>
<body name="a" pos="0 0 .5"><joint name="turn" axis="0 0 1" range="-90 90"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/>
<body name="hand" pos=".3 0 0"><joint name="out" type="slide" axis="1 0 0" range="0 .3"/><geom size=".02"/>
<site name="tip" pos=".1 0 0"/></body></body><body name="tool" pos=".45 0 .5"><freejoint/>
<geom type="capsule" fromto="-.125 0 0 .1 0 0" size=".01"/><geom type="capsule" fromto="0 0 0 0 0 -.1" size=".01"/>
</body></worldbody><equality><weld body1="hand" body2="tool"/></equality></mujoco>"""


def random_world(rng: np.random.Generator) -> str:
    """MJCF of a chain j0, j1, ... with followers on branches and a hand, on a sliding base, among things."""

    def numbers(*values: float) -> str:
        return " ".join(f"{value:.4f}" for value in values)

    def geom(name: str) -> str:
        margin, gap = rng.choice([0.0, 0.02, 0.05], 2)
        return f'<geom name="{name}" size="{rng.uniform(0.03, 0.12):.4f}" margin="{margin}" gap="{gap}"/>'

    def part(name: str, kind: str, inside: str = "", wide: float = 1.0) -> str:
        where, axis = numbers(*rng.uniform(-0.25, 0.25, 3)), numbers(*rng.normal(size=3))
        bounds = "" if kind == "ball" else f'range="{numbers(-wide * rng.uniform(0.3, 1), wide * rng.uniform(0.3, 1))}"'
        margin = rng.choice([0.0, 0.0, 0.05])
        joint = f'<joint name="{name}" type="{kind}" axis="{axis}" margin="{margin}" {bounds}/>' if kind else ""
        return f'<body name="b{name}" pos="{where}">{joint}{geom("g" + name)}{inside}</body>'

    kinds = list(rng.choice(["hinge", "slide"], 3)) + ["ball"] * (rng.random() < 0.3)
    scalars, ties = ["j0", "j1", "j2"], '<joint joint1="drum" joint2="j1" polycoef=".1 2 0 0 0"/>'
    tree = part("palm", "", part("finger1", "hinge") + part("finger2", "slide"))
    for k in reversed(range(len(kinds))):
        kind, leader = rng.choice(["hinge", "slide"]), rng.choice([*scalars, "drum"])
        curved = rng.normal(size=3) * (rng.random() < 0.3)
        ties += (
            f'<joint joint1="f{k}" joint2="{leader}" polycoef="{numbers(*rng.normal(scale=0.3, size=2), *curved)}"/>'
        )
        tree = part(f"j{k}", kinds[k], tree + part(f"f{k}", kind, part(f"e{k}", ""), wide=3.0))
    things = "".join(f'<geom name="t{k}" pos="{numbers(*rng.uniform(-0.6, 0.6, 3))}" size=".08"/>' for k in range(4))
    things += f'<body name="thing" pos=".3 .3 0"><freejoint/>{geom("thing")}</body>'
    pairs = "".join(
        f'<pair geom1="{a}" geom2="{b}" margin="{m}" gap=".01"/>'
        for a, b, m in (("gj0", "gj1", 0.1), ("gpalm", "t0", 0.3), ("gfinger1", "gj2", 0.0), ("gbase", "gj0", 0.02))
        if rng.random() < 0.3
    )
    rope = '<joint joint="j0" coef=".7"/><joint joint="j2" coef="-1"/>'
    rope = f'<fixed name="rope" range="-.9 .9" margin="{rng.choice([0.0, 0.1])}">{rope}</fixed>'
    return f"""<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{things}{part("drum", "hinge", wide=9.0)}
      {part("base", "slide", tree)}</worldbody><contact>{pairs}<exclude body1="bj0" body2="bpalm"/></contact>
      <tendon>{rope if rng.random() < 0.5 else ""}</tendon><equality>{ties}</equality></mujoco>"""


def with_cylinder(xml: str, rng: np.random.Generator) -> mujoco.MjModel:
    """A random world with a cylinder between its base and a link, its loop closed at qpos0."""
    spec = mujoco.MjSpec.from_string(xml)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    link = f"bj{rng.integers(3)}"
    foot, eye = rng.uniform([-0.3, -0.3, -0.8], [0.3, 0.3, -0.2]), rng.uniform(-0.1, 0.1, 3)
    way = data.body(link).xpos + eye - data.body("bbase").xpos - foot
    length = float(np.linalg.norm(way))
    across = np.cross(way, rng.normal(size=3))
    across /= np.linalg.norm(across)
    xyaxes = [*across, *np.cross(way / length, across)]
    barrel = spec.body("bbase").add_body(name="barrel", pos=foot)
    barrel.alt.xyaxes = xyaxes
    barrel.add_geom(name="gbarrel", size=[0.03, 0, 0])
    for name, axis in (("tilt", [1, 0, 0]), ("swivel", [0, 1, 0])):
        barrel.add_joint(name=name, axis=axis, range=[-0.9, 0.9])
    rod = barrel.add_body(name="rod")
    kind = mujoco.mjtJoint.mjJNT_SLIDE
    rod.add_joint(name="stroke", type=kind, axis=[0, 0, 1], range=[-0.3 * length, 0.3 * length])
    rod.add_geom(name="grod", size=[0.05, 0, 0], pos=[0, 0, 0.8 * length])
    rod.add_site(name="end", pos=[0, 0, length])
    spec.body(link).add_site(name="eye", pos=eye)
    loop = spec.add_equality(name="loop", type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_SITE)
    loop.name1, loop.name2 = "end", "eye"
    return spec.compile()
