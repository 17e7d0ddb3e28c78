"""A rod that swings past a wire: distances at samples, between them, and the bounds over intervals of time."""

import mujoco
import numpy as np
from drawings import style

import lieednn_sim as ls
from lieednn_sim.arm.clearance_bounds import ClearanceBounds
from lieednn_sim.planning.clearance import Cubics

model = mujoco.MjModel.from_xml_string(
    """<mujoco><worldbody><geom name="wire" type="capsule" fromto=".6 -.2 .2 .6 .2 .2" size=".001"/>
    <body><joint name="swing" axis="0 -1 0" range="-1 2"/>
      <geom type="capsule" fromto="0 0 0 .7 0 0" size=".001"/></body>
    </worldbody></mujoco>"""
)
arm = ls.Arm.of(model, mujoco.MjData(model), ["swing"], clearance=0.0)
count, angle = 9, np.arctan2(0.2, 0.6)
q = np.linspace(angle - 0.375, angle + 0.325, count + 1)[:, None]
cubics = Cubics(1.0, q, np.full_like(q, q[1, 0] - q[0, 0]))
bounds = ClearanceBounds(arm, [(np.zeros(1, dtype=int), np.ones(1))])


def distance(at):
    return 1e3 * bounds.least(*cubics.around(at, at), 1.0)[0]


_, (above, below) = style.figure(4.4, 2, 1, height_ratios=(3, 2))
for k, (turn,) in enumerate(q):
    above.plot([0.0, 0.7 * np.cos(turn)], [0.0, 0.7 * np.sin(turn)], color=style.BLUE, lw=1.2)
    above.text(0.72 * np.cos(turn), 0.72 * np.sin(turn), str(k), color=style.BLUE, va="center")
above.plot(0.6, 0.2, "o", color=style.RED, ms=4)
above.annotate("a wire", (0.6, 0.2), (0.12, 0.4), color=style.RED, arrowprops={"arrowstyle": "-", "color": style.RED})
above.set(aspect="equal", xlim=(-0.05, 0.85), ylim=(-0.08, 0.5))
above.axis("off")
fine = np.linspace(0.0, count, 901)
below.plot(fine, distance(fine), color=style.GREY, lw=1.2, label="distance from the wire")
below.plot(
    np.arange(count + 1), distance(np.arange(count + 1.0)), "o", color=style.BLUE, ms=4, label="samples: all clear"
)
begin = np.arange(0.0, count, 0.5)
least = 1e3 * bounds.least(*cubics.around(begin, begin + 0.5), 1.0)[0]
for low, left in zip(least, begin, strict=True):
    colour = style.GREEN if low > 0.0 else style.RED
    below.fill_between([left, left + 0.5], 0.0 if low > 0.0 else -12.0, max(low, 0.0), color=colour, alpha=0.35, lw=0.0)
below.plot([], [], "s", color=style.GREEN, alpha=0.5, label="proved for the interval")
below.plot([], [], "s", color=style.RED, alpha=0.5, label="not proved: divided")
below.set(xlabel="sample", ylabel="distance [mm]", xlim=(0.0, count), ylim=(-12.0, None))
below.legend(
    frameon=False, loc="lower center", bbox_to_anchor=(0.45, 1.0), ncol=2, columnspacing=0.8, handletextpad=0.3
)
