r"""
Pick, carry, place
==================

Reach for a box, close the gripper, carry the box around an obstacle, and put it down, in a MuJoCo model.
``ls.plan_sequence`` plans each move with its own proof, and ``ls.simulate`` simulates the whole sequence in the given
model, where only friction holds the box.
"""

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import lieednn_sim as ls

# %%
# A telescopic arm with a parallel gripper in a cell of the package; any other ``MjModel`` will do.

model = mujoco.MjModel.from_xml_path(str(ls.arm.models_directory() / "picking_cell" / "cell.xml"))
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
joints = ["turn", "lift", "extend", "pitch", "yaw"]
speeds = {"turn": 1.5, "lift": 1.0, "extend": 0.6, "pitch": 2.0, "yaw": 3.0}


def down(x, y, z):
    """A pose of the hand that points down."""
    return RigidTransform.from_components([x, y, z], Rotation.from_euler("y", 90.0, degrees=True))


# %%
# The steps. While the box is held it is part of the hand: it keeps its distance from the wall, and may touch the table
# that it stands on and the shelf that it is put on. The gripper step ends when the fingers rest.

steps = [
    ls.Move(down(0.62, -0.45, 0.32), name="above the box"),
    ls.Move(down(0.62, -0.45, 0.225), name="to the box", duration=1.0),
    ls.Actuate({"gripper": 0.0}, seconds=1.0, until="settled", name="grasp"),
    ls.Move(down(0.62, 0.45, 0.326), name="carry", holding="box", touching=["shelf"]),
    ls.Actuate({"gripper": 0.04}, name="release"),
    ls.Move(down(0.62, 0.45, 0.42), name="retreat", duration=1.0),
    ls.Move("home"),
]
limits = {name: {"velocity": speed} for name, speed in speeds.items()}
arm = ls.Arm.of(model, data, joints, tip="grasp", limits=limits)
sequence = ls.plan_sequence(arm, steps)
print(sequence)

# %%
# One run of all steps. The box is released 6 mm above the shelf; its position is measured when it rests.

run = ls.simulate(arm, sequence)
box = run.poses("box").translation
print(f"largest tracking error: {np.abs(run.tracking_error).max():.2g} rad or m")
print(f"the box was lifted to {box[:, 2].max():.2f} m, over a wall of 0.48 m")
print(f"it stands {1e3 * np.linalg.norm(box[-1] - [0.62, 0.45, 0.32]):.1f} mm from its place")
ls.render_page(run, "motion.html")
