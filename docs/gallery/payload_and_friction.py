"""
Payload, wrong masses, noise and friction
=========================================

Which controller copes best with an inexact model? Here three controllers follow the same motion under four conditions:
all masses are 20 % larger than in the controller's model, the arm carries an unknown payload of 2 kg, the sensors are
noisy, or every joint has dry friction. The figure shows the error of the end effector over time; no controller is the
best under all four.
"""

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr")
planned = ls.plan(arm, "extended", duration=4.0, seed=0)

# %%
# Masses, payload and noise are disturbances, which no controller knows. Friction is part of the arm's model: 5 N m in
# each hinge and 20 N in each slide. Controllers that use the model know it.

spec = arm.spec.copy()
for joint in spec.joints:
    joint.frictionloss = 20.0 if joint.type == mujoco.mjtJoint.mjJNT_SLIDE else 5.0
rough = ls.Arm.from_spec(spec, arm.source, "telescopic_pr with friction")
cases = {
    "masses 20 % larger": (arm, ls.Disturbances(mass_scale=1.2)),
    "payload of 2 kg": (arm, ls.Disturbances(payload=2.0)),
    "noise of 0.1 mm, 0.1 mrad": (arm, ls.Disturbances(position_noise=1e-4)),
    "dry friction": (rough, ls.Disturbances()),
}

# %%
# ``position-servo`` uses only the joints' damping from the model. ``inverse-dynamics`` adds the forces that the model
# needs to the servo, and ``computed-torque`` replaces the servo by feedback through the model. If the model is right,
# the servo follows within 0.12 mm and the others exactly. The motion ends after 4 s.

controllers = {"position-servo": "-", "inverse-dynamics": "--", "computed-torque": "-."}
figure, axes = plt.subplots(2, 2, figsize=(6.4, 5.0), sharex=True, layout="constrained")
print(f"{'RMS error [mm]':<26}  {'  '.join(controllers)}")
for panel, (name, (plant, disturbances)) in zip(axes.flat, cases.items(), strict=True):
    row = []
    for controller, dash in controllers.items():
        how = {"controller": controller, "disturbances": disturbances}
        rollout = ls.simulate(plant, planned.motion, **how)
        offset = rollout.link_position[:, -1] - plant.tip(rollout.q_ref)
        error = 1e3 * np.linalg.norm(offset, axis=1)
        panel.plot(rollout.t, error, dash, lw=1.0, label=controller)
        row.append(f"{np.sqrt(np.mean(error**2)):{len(controller)}.3f}")
    print(f"{name:<26}  {'  '.join(row)}")
    panel.set(title=name, ylim=(0.0, None))
figure.supxlabel("time [s]", fontsize="medium")
figure.supylabel("error of the end effector [mm]", fontsize="medium")
handles = axes[0, 0].get_legend_handles_labels()
figure.legend(*handles, loc="outside upper center", ncols=3)

# %%
# A model does not help against errors that it does not contain, such as wrong masses or a payload. The feedback of
# computed torque is softer: the arm sags more under the payload, but less noise reaches the joints. Known friction is
# compensated.
