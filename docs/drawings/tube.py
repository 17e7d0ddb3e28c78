"""A motion through a window, and the tube that is proved around it."""

import numpy as np
from drawings import style

import lieednn_sim as ls
from lieednn_sim.planning import find_tube

arm = ls.Arm.load("telescopic_pr", scene="window", seed=1)
plan = ls.plan(arm, ls.draw_target(arm, seed=1), seed=1)
tube = find_tube(arm, plan)
print(tube, tube.rotation, tube.translation)
