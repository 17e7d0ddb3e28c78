"""
Payload, wrong masses, noise and friction
=========================================

No controller knows its arm exactly. Who chooses a controller wants to know what each
kind of ignorance costs. Here the same motion is followed by three controllers under
four disturbances: masses that are all 20 % larger than the controller's model says, an
unknown payload of 2 kg, noisy sensors, and dry friction in every joint. One sees the
error of the end effector over time, and that the best controller for one disturbance is
not the best for another.
"""

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr")
planned = ls.plan(arm, "extended", duration=4.0, seed=0)

# %%
# Masses, payload and noise are disturbances, which no controller knows. The friction
# belongs to the arm: a copy of its model gets 5 N m in each hinge and 20 N in each
# slide. Controllers that use a model know this friction.

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
# ``position-servo`` uses no model, ``inverse-dynamics`` adds the forces of the model
# to the servo, and ``computed-torque`` replaces the servo by feedback through the
# model. All follow the motion exactly, or within 0.12 mm, when their model is right.
# The motion ends after 4 s; then the arm holds its position for 1 s.

controllers = {"position-servo": "-", "inverse-dynamics": "--", "computed-torque": "-."}
figure, axes = plt.subplots(2, 2, figsize=(6.4, 5.0), sharex="all", layout="constrained")
print(f"{'RMS error of the tip [mm]':<26}  {'  '.join(controllers)}")
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
for panel in axes[1]:
    panel.set_xlabel("time [s]")
for panel in axes[:, 0]:
    panel.set_ylabel("error [mm]")
handles = axes[0, 0].get_legend_handles_labels()
figure.legend(*handles, loc="outside upper center", ncols=3)

# %%
# A model does not help against what it does not contain: with wrong masses or a
# payload the servo is as good without it, and computed torque, whose feedback is
# softer, sags more under the payload. It does filter noise better. Friction that the
# model knows is compensated.
