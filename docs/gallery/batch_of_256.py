"""
A batch of 256 simulations
==========================

Simulate many motions at once to see how a controller performs under varying conditions. This example simulates 256
motions in threads: 32 random targets with eight random payloads each. It shows how far the end effector is from its
target at the end, and how much faster a batch is than single simulations.
"""

import time

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls

# %%
# Each motion is planned once and simulated with every payload. Each target is 30 % of the way from home to a random
# configuration. A straight minimum-jerk motion takes 0.5 s, or longer if the arm's limits require it.

arm = ls.Arm.load("telescopic_pr")
drawn = np.array([ls.draw_target(arm, seed) for seed in range(32)])
targets = 0.7 * arm.keyframe("home") + 0.3 * drawn
how = {"planner": "minimum-jerk", "duration": (0.5, 3.0)}
plans = [ls.plan(arm, target, **how) for target in targets]
payloads = np.sort(np.random.default_rng(0).uniform(0.0, 2.0, 8))

# %%
# One call simulates all motions with one payload. The controller uses only the reference, so all controls are known
# beforehand and MuJoCo makes all steps in one call. The states equal those of ``ls.simulate`` to the last bit.

loads = [ls.Disturbances(payload=mass) for mass in payloads]
begun = time.perf_counter()
batches = [ls.simulate_many(arm, plans, hold=0.2, disturbances=load) for load in loads]
in_batch = time.perf_counter() - begun
steps = sum(batch.q[..., 0].size for batch in batches)
begun = time.perf_counter()
alone = [ls.simulate(arm, plan, hold=0.2, disturbances=loads[0]) for plan in plans[:8]]
one_by_one = time.perf_counter() - begun
each = sum(len(rollout.t) for rollout in alone) / one_by_one
print(f"{sum(map(len, batches))} simulations of {steps} steps in {in_batch:.2f} s")
print(f"{steps / in_batch:.0f} steps/s in batches, {each:.0f} steps/s one by one")
pairs = zip(alone, batches[0].q[:8], strict=True)
same = all(np.array_equal(one.q, states[: len(one.q)]) for one, states in pairs)
print(f"the same states in the batch and alone, bit for bit: {same}")

# %%
# The final error is proportional to the payload, with a factor that depends on the configuration.

reached = arm.tip(np.array([batch.q[:, -1] for batch in batches]))
errors = 1e3 * np.linalg.norm(reached - arm.tip(targets), axis=-1)
print(f"final error: median {np.median(errors):.2f} mm, largest {errors.max():.2f} mm")
factor = errors / payloads[:, None]
print(f"per kilogram of payload: {factor.min():.2f} to {factor.max():.2f} mm")
figure, panel = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
shades = plt.cm.viridis(np.linspace(0.9, 0.1, len(payloads)))
names = [f"{mass:.2f} kg" for mass in payloads]
panel.hist(list(errors), bins=20, stacked=True, color=shades, label=names)
panel.set(title="256 simulations", xlabel="final error [mm]", ylabel="simulations")
panel.legend(title="payload", fontsize="small")
