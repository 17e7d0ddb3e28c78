"""
Through a window
================

A plan through a narrow window, by ``lieednn-shaped``.
"""

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr", scene="window", seed=1)
planned = ls.plan(arm, ls.draw_target(arm, seed=1))
print(planned.details.deviation)
