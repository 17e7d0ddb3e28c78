"""Views of compiled models against MuJoCo's own answers."""

import mujoco
import numpy as np
import pytest

import lieednn_sim as ls

FINGER = '<body pos=".3 {0}.03 0"><joint name="f{0}" type="slide" axis="0 1 0"/><geom size=".03"/></body>'
ARM = f"""
<mujoco><worldbody><geom type="box" size="1 1 .1" pos="0 0 -.6"/>
  <body pos=".5 .2 -.4"><freejoint/><geom size=".1"/></body>
  <body pos="-.1 0 0"><joint name="locked" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 -.4 0 0" size=".04"/>
    <body pos=".1 0 0"><joint name="a" axis="0 1 0" range="-170 170"/>
      <geom type="capsule" fromto=".1 0 0 .4 0 0" size=".04"/>
      <body pos=".5 0 0"><joint name="b" axis="0 1 0" range="-170 170"/>
        <geom type="capsule" fromto=".1 0 0 .2 0 0" size=".03"/>{FINGER.format("")}{FINGER.format("-")}
</body></body></body></worldbody></mujoco>"""


def test_contacts_are_mujocos_between_what_the_arm_moves_against_each_other():
    """Not those of its fingers, nor of a ball on a table; but of fingers and forearm."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data, rng, seen = mujoco.MjData(model), np.random.default_rng(0), 0
    data.joint("locked").qpos = 0.4
    arm = ls.Arm.of(model, data, ["b", "a"])
    group = [int(arm.moved_by(body)[arm.space.rate_addresses].sum()) for body in range(model.nbody)]
    for q in rng.uniform(*arm.position_limits.T, (300, 2)):
        data.qpos[:] = arm.qpos(q)
        mujoco.mj_forward(model, data)
        pairs = {tuple(model.geom_bodyid[geoms].tolist()) for geoms in data.contact.geom}
        moved = {pair for pair in pairs if group[pair[0]] != group[pair[1]]}
        found = {tuple(model.geom_bodyid[geoms].tolist()) for geoms in arm.contact_finder().geoms(data.qpos)[1]}
        assert found == moved
        seen += len(moved)
    assert seen > 100


@pytest.mark.parametrize(("height", "contact"), [(0.119, True), (0.121, False), (0.139, False)])
def test_in_a_gap_there_is_no_force(height, contact):
    body = (
        '<body><joint name="z" type="slide" axis="0 0 1" range="0 1"/><geom size=".1" margin=".02" gap=".02"/></body>'
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="plane" size="1 1 1"/>{body}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.joint("z").qpos = height
    arm = ls.Arm.of(model, data, ["z"])
    mujoco.mj_forward(model, data)
    assert data.ncon == 1
    assert bool(arm.contacts([height])) == contact == bool(data.efc_force[: data.nefc].any())
