"""
Between a learned policy and the arm
====================================

Learned policies emit *action chunks*: some tens of joint targets that come late, with noise, with jumps from one chunk
to the next, and sometimes through a table. This example imitates such a policy. Played unchanged, its chunks shake the
arm and hit the table. With ``lieednn-chunks`` in between, the arm follows what it can, and refuses the rest.
"""

from collections import deque
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls
from lieednn_sim.policies import Policy

Path("table.yaml").write_text("""
obstacles:
  - {shape: box, name: table, size: [0.8, 1.6, 0.05], position: [1.15, 0, 0.5]}
""")
arm = ls.Arm.load("telescopic_pr", scene="table.yaml")
start = ls.solve_ik(arm, (1.15, 0.5, 0.75))
goal = ls.solve_ik(arm, (1.15, -0.5, 0.75), start=start)
below = ls.solve_ik(ls.Arm.load("telescopic_pr"), (1.15, -0.1, 0.3), start=start)

# %%
# The "learned" policy approaches its goal from the measured joints, with 50 targets at 50 Hz every 0.4 s. They come 0.3
# s late, with noise and an offset, and every fourth chunk leads to a place below the table.

PERIOD, DELAY, STEP = 0.4, 0.3, 0.02


class Learned:
    """The stand-in; in each control period it is asked for the chunk that has come, if one has."""

    def __init__(self):
        self.rng, self.on_their_way, self.made = np.random.default_rng(1), deque(), 0

    def __call__(self, now, q):
        if now >= self.made * PERIOD - 1e-9:
            aim = below if self.made % 4 == 2 else goal
            chunk = aim + (q - aim) * np.exp(-1.2 * STEP * np.arange(50))[:, None]
            chunk += 0.01 * self.rng.standard_normal(8) + 0.002 * self.rng.standard_normal((50, 8))
            self.on_their_way.append((now, chunk))
            self.made += 1
        if self.on_their_way and now >= self.on_their_way[0][0] + DELAY - 1e-9:
            then, chunk = self.on_their_way.popleft()
            return np.clip(chunk, *arm.position_limits.T), then, STEP
        return None


class Raw(Policy):
    """Plays the last chunk from its beginning, as it comes."""

    def begin(self, q):
        self.source, self.now, self.last = Learned(), 0.0, (0.0, q[None])

    def act(self, measured, target):
        if given := self.source(self.now, measured):
            self.last = self.now, given[0]
        self.now += self.period
        begin, chunk = self.last
        q = chunk[min(int((self.now - begin) / STEP), len(chunk) - 1)]
        return q, (q - self.q) / self.period


# %%
# Both control the simulated arm at 100 Hz. The first page shows the raw chunks, the second ``lieednn-chunks``.

policy = ls.make_policy("lieednn-chunks", arm, start, start=start, rate=100)
policy.source = Learned()
runs = {}
for name, each in (("raw", Raw(arm, 100)), ("lieednn-chunks", policy)):
    run = runs[name] = replace(ls.follow(each, start, 8.0, start=start).rollout, target=goal)
    judged = ls.evaluate(run)
    print(f"{name}: contact force {judged.peak_contact_force_n:.0f} N, ends {judged.final_effector_mm:.0f} mm off")
    ls.render_page(run, f"{name}.html", title=name)
print(dict(policy.counts))

# %%
# Above: the height of the end effector. Below: the reference of the first joint.

figure, (height, joint) = plt.subplots(2, 1, figsize=(6.4, 4.6), layout="constrained", sharex=True)
for name, run in runs.items():
    height.plot(run.t, arm.tip(run.q)[:, 2], label=name)
    joint.plot(run.t, run.q_ref[:, 0])
height.axhspan(0.475, 0.525, color="0.7", label="table")
height.set(ylabel="height [m]")
joint.axhline(goal[0], color="black", lw=1, ls=":", label="goal")
joint.set(xlabel="time [s]", ylabel="first joint [rad]")
figure.legend(loc="outside upper center", ncols=4)
