"""The mechanism gap: a pose decoded from a network, the nearest one that the joint can take, and its course."""

import numpy as np
from drawings import style

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr")
network = ls.synthesize(arm.encode(arm.keyframe("extended")), seed=0).unwrap()
chosen = ls.plan(arm, "extended", seed=0).network
tau = np.linspace(0.0, 15.0, 301)
link, k = 2, 68

_, (above, below) = style.figure(5.2, 2, 1, height_ratios=(3, 2))
for each, colour, label in (
    (network, style.GREY, "a random certified network"),
    (chosen, style.ORANGE, "the network that the planner chose"),
):
    states = each.trajectory(arm.encode(arm.keyframe("home")), tau[-1])(tau)
    gap = arm.decode(states).gap_translation.max(axis=1)
    below.plot(tau, 1e3 * gap, color=colour, lw=1.5, label=label)
below.set(xlabel="network's own time", ylabel="mechanism gap [mm]", ylim=(0.0, None))
below.legend(frameon=False)

xi = network.trajectory(arm.encode(arm.keyframe("home")), tau[-1])(tau)[k]
nearest = arm.decode(xi)
feasible = arm.link_poses(nearest.q)
joint = ls.lie.exp(xi[link] * arm.twist_units)
decoded = feasible[link - 1] * arm.mounts[link] * joint * arm.tips[link]
seen_at = style.show_arm(above, arm, nearest.q, size=(960, 640), crop=(0.36, 0.92, 0.52, 0.06))
ends = style.draw_frames(above, seen_at, [feasible[link].as_matrix(), decoded.as_matrix()], 0.2)
above.plot(*ends.T, "--", color="black", lw=1.5)
box = {"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.85}
above.text(*(ends[0] + (-16, -66)), "nearest pose that the joint can take", ha="center", bbox=box)
above.text(*(ends[1] + (0, 46)), "pose decoded from the network", ha="center", bbox=box)
