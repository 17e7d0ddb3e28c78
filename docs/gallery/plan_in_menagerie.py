r"""
A plan with a robot of the Menagerie
====================================

Take a robot of the `MuJoCo Menagerie <https://github.com/google-deepmind/mujoco_menagerie>`_, add furniture and
objects, and plan among them. Here a KUKA LBR iiwa 14 reaches out of one compartment of a shelf and into another, past
free-standing cans.

The script needs the Menagerie's files; the package ``mujoco-menagerie`` (pip) downloads them at first use. They are not
part of this project, so the site's build does not run this script. The page was made on 25 November 2026, with MuJoCo
3.17.0, lieednn_sim 0.2.0, and a copy of the Menagerie's folder of this robot. It shows the Menagerie's meshes, under
`their licence <../../_static/kept/plan_in_menagerie.license.txt>`__.

.. raw:: html

   <figure class="turning">
   <iframe src="../../_static/kept/plan_in_menagerie.html" title="Plan in a shelf" loading="lazy"></iframe>
   <figcaption>Drag to turn, scroll to zoom. <a href="../../_static/kept/plan_in_menagerie.html"
   target="_blank">Open alone</a></figcaption>
   </figure>
"""

# sphinx_gallery_thumbnail_path = '_static/kept/plan_in_menagerie.jpg'
import mujoco
import mujoco_menagerie
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import lieednn_sim as ls

# %%
# Add a shelf, cans and a camera to the Menagerie's scene.

spec = mujoco_menagerie.get("kuka_iiwa_14").spec()
spec.delete(spec.body("target"))  # a mocap body that nobody needs here
world, box, cylinder = spec.worldbody, mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
world.add_camera(name="overview", pos=[-1.05, -1.9, 1.35], xyaxes=[0.78, -0.62, 0, 0.22, 0.28, 0.93])
boards = [([0.62, 0, z], [0.15, 0.4, 0.01]) for z in (0.2, 0.55, 0.9)]
boards += [([0.62, y, 0.45], [0.15, 0.01, 0.45]) for y in (-0.39, 0.0, 0.39)]
for place, half in boards:
    world.add_geom(type=box, pos=place, size=half, rgba=[0.72, 0.58, 0.42, 1])
for k, place in enumerate([[0.58, 0.12, 0.62], [0.6, 0.3, 0.62], [0.58, -0.32, 0.62], [0.6, -0.12, 0.27]]):
    can = world.add_body(name=f"can {k}", pos=place)
    can.add_freejoint()
    can.add_geom(type=cylinder, size=[0.035, 0.06, 0], mass=0.3, rgba=[0.2, 0.45, 0.65, 1])
model = spec.compile()
data = mujoco.MjData(model)
data.qpos[:7] = [0, -0.5, 0, -2, 0, 1.2, 0]
mujoco.mj_forward(model, data)

# %%
# The flange moves into the lower left compartment, and from there into the upper right one. The velocity limits are
# from the data sheet; the Menagerie has no acceleration limits for this arm.

joints = [f"joint{k}" for k in range(1, 8)]
speeds = np.deg2rad([85, 85, 100, 75, 130, 135, 135])
limits = {joint: {"velocity": speed, "acceleration": 5.0} for joint, speed in zip(joints, speeds, strict=True)}
forwards = Rotation.from_euler("y", 90, degrees=True)
inside = [RigidTransform.from_components(place, forwards) for place in ([0.55, 0.2, 0.38], [0.6, -0.15, 0.72])]
steps = [ls.Move(inside[0], name="into the lower left"), ls.Move(inside[1], name="into the upper right", fastest=True)]
arm = ls.Arm.of(model, data, joints, tip="attachment_site", limits=limits)
found = ls.plan_sequence(arm, steps)
print(found)

# %%
# The simulation uses the same model, and the arm's own servos follow the plan.

run = ls.simulate(arm, found)
print(f"largest tracking error: {np.rad2deg(np.abs(run.tracking_error).max()):.2f} degrees")
ls.render_page(run, "plan_in_menagerie.html", title="A shelf")
