r"""
Pick and place in a task of robosuite
=====================================

Plan certified motions in tasks of `robosuite <https://robosuite.ai>`_, as demonstrations or as an expert. In the task
``PickPlace`` a Panda takes a can out of a bin, between milk, bread and cereal, and puts it into its quarter of the
other bin.

robosuite 1.5.2 cannot be installed beside this package: it needs NumPy below 2, and its environments do not start with
MuJoCo 3.17, which this package needs. So save the task in a separate environment, by
``pip install robosuite==1.5.2 mujoco==3.3.7`` and these lines:

.. code-block:: python

   import numpy as np
   import robosuite

   quiet = dict(has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False)
   env = robosuite.make("PickPlace", robots="Panda", seed=1, **quiet)
   env.reset()
   for _ in range(20):  # the objects come to rest
       env.step(np.zeros(env.action_dim))
   with open("pick_place.xml", "w") as file:
       file.write(env.sim.model.get_xml())
   np.save("pick_place.npy", env.sim.data.qpos)

The XML refers to the meshes of the installed robosuite, so both environments must be on the same machine. robosuite's
models are not part of this project, so the site's build does not run this script. The page was made on 25 November
2026, with MuJoCo 3.17.0 and lieednn_sim 0.2.0. It shows robosuite's collision meshes, under
`its licence <../../_static/kept/plan_in_robosuite.license.txt>`__.

.. raw:: html

   <figure class="turning">
   <iframe src="../../_static/kept/plan_in_robosuite.html" title="Pick and place" loading="lazy"></iframe>
   <figcaption>Drag to turn, scroll to zoom. <a href="../../_static/kept/plan_in_robosuite.html"
   target="_blank">Open alone</a></figcaption>
   </figure>
"""

# sphinx_gallery_thumbnail_path = '_static/kept/plan_in_robosuite.jpg'
import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import lieednn_sim as ls

model = mujoco.MjModel.from_xml_path("pick_place.xml")
model.geom_rgba[model.geom_group == 1, 3] = 0  # the page is a sixth as large without the visual meshes
data = mujoco.MjData(model)
data.qpos[:] = np.load("pick_place.npy")
mujoco.mj_forward(model, data)

# %%
# The hand points downwards over a point, at a given height. It may turn about the vertical, since the can is round.


def over(point, height, tolerance=(0.0, 0.0)):
    """Return the poses of the hand at ``height`` over a point, which may be off by ``tolerance`` along x and y [m]."""
    above = RigidTransform.from_translation(point + np.array([0.0, 0.0, height]))
    bounds = np.array([*tolerance, 0.0, 0.0, 0.0, np.inf])
    downwards = RigidTransform.from_rotation(Rotation.from_euler("x", 180, degrees=True))
    return ls.TaskSpaceRegion(above, -bounds, bounds, downwards)


# %%
# Moves of the arm, each with its proof, and steps of the fingers. In the other bin the can may be put anywhere in the
# part of its quarter that the Panda can reach from above; the farthest corner is out of reach.

can, quarter = data.body("Can_main").xpos, data.body("VisualCan_main").xpos - np.array([0.035, 0.02, 0.0])
fingers = [f"gripper0_right_gripper_finger_joint{k}" for k in (1, 2)]


def opened(width, seconds, name):
    """Return the step that moves the fingers to a distance of ``width`` [m]."""
    return ls.Actuate({fingers[0]: 0.5 * width, fingers[1]: -0.5 * width}, seconds=seconds, name=name)


steps = [
    opened(0.08, 0.5, "open"),
    ls.Move(over(can, 0.12), name="above the can"),
    ls.Move(over(can, 0.02), name="to the can", duration=3.0),
    opened(0.0, 0.8, "grasp"),
    ls.Move(over(quarter, 0.05, (0.02, 0.04)), name="carry", holding="Can_main", duration=8.0),
    opened(0.062, 0.8, "release"),
    ls.Move(data.qpos[:7].copy(), name="return", duration=6.0),
]

# %%
# The velocity limits are the Panda's. All motions are planned first, and then simulated in robosuite's model, in which
# the robot's motors follow the plan and friction holds the can.

joints = [f"robot0_joint{k}" for k in range(1, 8)]
speeds = [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]
limits = {joint: {"velocity": speed} for joint, speed in zip(joints, speeds, strict=True)}
arm = ls.Arm.of(model, data, joints, tip="gripper0_right_grip_site", limits=limits)
found = ls.plan_sequence(arm, steps)
print(found)
run = ls.simulate(arm, found)
print(run)
print("the can stands at", run.poses("Can_main")[-1].translation.round(3))
ls.render_page(run, "plan_in_robosuite.html", title="PickPlace")
