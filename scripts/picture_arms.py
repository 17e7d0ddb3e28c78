"""One picture of the package's arms, alone and among obstacles on the path of a guided network.

python scripts/picture_arms.py [FILE]     # default: results/arms.jpg; needs headless OpenGL and the extra rivals
"""

from __future__ import annotations

import sys

import numpy as np
from PIL import Image

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.planning import plan
from lieednn_sim.rendering.video import Camera

SIZE = (640, 440)
ALONE = ("telescopic_pr", "telescopic_rrp", "telescopic_compound")
AMONG = (("telescopic_pr", "window", 1), ("telescopic_rrp", "shelf", 3), ("telescopic_compound", "poles", 2))


def picture(arm: Arm, q: np.ndarray, target: np.ndarray) -> np.ndarray:
    with Camera(arm, size=SIZE, target=target) as camera:
        return camera.picture(q).copy()


def main(path: str = "results/arms.jpg") -> None:
    above, below = [], []
    for name in ALONE:
        arm = Arm.load(name)
        home, extended = arm.keyframe("home"), arm.keyframe("extended")
        above.append(picture(arm, 0.55 * home + 0.45 * extended, extended))
    for name, scene, seed in AMONG:
        arm = Arm.load(name, scene, seed)
        target = draw_target(arm, seed)
        motion = plan(arm, target, planner="lieednn-guided", seed=seed).motion
        below.append(picture(arm, motion.q[int(0.7 * len(motion.q))], target))
    with io.atomic_path(path) as temporary:
        Image.fromarray(np.vstack([np.hstack(above), np.hstack(below)])).save(temporary, quality=86)
    print(path)


if __name__ == "__main__":
    main(*sys.argv[1:2])
