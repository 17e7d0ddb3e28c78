"""One picture of the package's arms, alone and among obstacles on their way.

python scripts/picture_arms.py [FILE]     # default: results/arms.jpg; needs headless OpenGL and the extra rivals
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import lieednn_sim as ls
from lieednn_sim import io
from lieednn_sim.rendering.video import Camera

SIZE = (640, 440)
ALONE = ("telescopic_pr", "telescopic_rrp", "telescopic_compound")
AMONG = (("telescopic_pr", "window", 1), ("telescopic_rrp", "shelf", 3), ("telescopic_compound", "poles", 2))


def main(path: str = "results/arms.jpg") -> None:
    def picture(arm: ls.Arm, q: np.ndarray, target: np.ndarray) -> np.ndarray:
        with Camera(arm, size=SIZE, target=target) as camera:
            return camera.picture(q).copy()

    above, below = [], []
    for arm in map(ls.Arm.load, ALONE):
        home, extended = arm.keyframe("home"), arm.keyframe("extended")
        above.append(picture(arm, 0.55 * home + 0.45 * extended, extended))
    for name, scene, seed in AMONG:
        arm = ls.Arm.load(name, scene, seed)
        target = ls.draw_target(arm, seed)
        motion = ls.plan(arm, target, planner="lieednn-shaped", seed=seed).motion
        below.append(picture(arm, motion.q[int(0.7 * len(motion.q))], target))
    io.make_directory(Path(path).parent)
    with io.atomic_path(path) as temporary:
        Image.fromarray(np.vstack([np.hstack(above), np.hstack(below)])).save(temporary, quality=86)
    print(path)


if __name__ == "__main__":
    main(*sys.argv[1:2])
