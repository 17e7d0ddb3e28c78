"""
A boom that a cylinder lifts
============================

Plan for a crane, a platform or an excavator whose boom is lifted by a hydraulic cylinder, through a closed loop. A
``connect`` of MuJoCo joins boom and cylinder, and only the cylinder is driven. The arm's coordinates are those of the
boom: slew, luff, extension. The angle and stroke of the cylinder follow from them by Newton's method on MuJoCo's
residuals, and the same Jacobian maps the forces.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_crane")
print(arm.joint_names, "of", arm.model.njnt, "joints")

# %%
# A certified network leads the boom between poles. The plan has all joints of the model, including the cylinder's.

arm = arm.with_scene("poles", seed=1)
plan = ls.plan(arm, ls.draw_target(arm, seed=3), duration=16.0)
stroke = arm.model.joint("stroke").qposadr[0]
print(plan.network.certificate)
print(f"the cylinder goes from {plan.qpos[0, stroke]:.3f} to {plan.qpos[-1, stroke]:.3f} m")

# %%
# In the simulation the cylinder lifts and holds the weight within its force limit; the hook swings freely.

cylinder = arm.model.actuator("stroke").id
force = ls.Channel("cylinder", "N", lambda data: data.actuator_force[cylinder : cylinder + 1])
run = ls.simulate(arm, plan, hold=2.0, log=[force])
print(f"the boom point ends {ls.evaluate(run, clearance=False).final_worst_mm:.3f} mm off")

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(6.4, 4.4), layout="constrained")
above.plot(run.t, 1e-3 * run.channels["cylinder"])
above.set_ylabel("cylinder's force [kN]")
swing = [arm.model.joint(name).qposadr[0] for name in ("swing_along", "swing_across")]
luff = arm.model.joint("luff").qposadr[0]
hook = run.qpos[:, swing]
hook[:, 0] -= run.qpos[:, luff]
below.plot(run.t, np.rad2deg(hook), label=["along the boom", "across"])
below.set(xlabel="time [s]", ylabel="hook off vertical [degrees]")
below.legend()
ls.render_page(run, "motion.html")
