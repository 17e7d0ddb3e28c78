"""Makes the page `browser.html`: an arm in MuJoCo's WebAssembly build, led by certified networks, in one file.

npm fetches the pinned packages and esbuild joins them; what the page shows is made by the package.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
import shutil
import subprocess
import sys
import tempfile
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

import lieednn_sim as ls
from lieednn_sim.live.engine import Progress, foreseen
from lieednn_sim.planning.monitor import ClearanceMonitor

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
# Not below `docs`, where Sphinx and tests would read the packages' pages.
WORK = ROOT / "build" / "browser"


class Scene(NamedTuple):
    """A scene: its policy, the seed of obstacles and target, a push of 0.2 s [N], and what is said of it."""

    policy: str
    seed: int
    push: float
    about: str


SCENES = {
    "free": Scene(
        "lieednn-certified",
        1,
        350.0,
        "The network of lieednn-certified: 24 numbers for four links, no search. The joints that put the end effector "
        "onto the ball are found by damped least squares.",
    ),
    "window": Scene(
        "lieednn-shaped",
        0,
        240.0,
        "The network of lieednn-shaped goes through the window along a path that its hidden neurons encode; to the "
        "ball's first place it is proved to keep {clearance} off everything. Other places in the green box, and "
        "pushes, keep the proof of arrival, not that of the clearance.",
    ),
}
NOT_DRAWN = {"floor", "target_sphere", "target_axis_x", "target_axis_y", "target_axis_z"}


def policy_of(scene: str) -> tuple[ls.NetworkPolicy, np.ndarray]:
    """The policy of a scene, at home, and its first target ``(n,)``."""
    name, seed, *_ = SCENES[scene]
    arm = ls.Arm.load("telescopic_pr", scene=scene, seed=seed)
    target = ls.draw_target(arm, seed=seed)
    policy = ls.make_policy(name, arm, target)
    assert isinstance(policy, ls.NetworkPolicy)
    return policy, target


def exported(policy: ls.NetworkPolicy) -> dict[str, Any]:
    """What the package exports for C, of the network and of the policy, by the names in their headers."""
    numbers = {}
    with tempfile.TemporaryDirectory() as folder:
        policy.to_c(folder)
        for part, header in (("network", "lieednn_numbers.h"), ("policy", "policy_numbers.h")):
            text = Path(folder, header).read_text(encoding="utf-8")
            macros = re.findall(r"#define [A-Z]+_(\w+) (-?[\d.e+-]+) /\*", text)
            arrays = re.findall(r"static const \w+ (\w+)[\[\d\]]+ = (\{.*?\});", text, re.DOTALL)
            numbers[part] = {name: float(value) for name, value in macros}
            numbers[part] |= {name: json.loads(value.translate(str.maketrans("{}", "[]"))) for name, value in arrays}
    # What policy.js is written for.
    arm, network, values = policy.arm, policy.network, numbers["policy"]
    assert network.activation == "tanh"
    assert values["turns"] == [1, 0] * arm.n_links
    assert values["mover"] == list(range(arm.n_joints))
    assert not np.any([*np.ravel(values["anchor"]), *values["reference"]])
    assert not numbers["network"]["START_LAW"]
    assert (values["FEEDBACK"], values["FEEDFORWARD"]) == (1, 0)
    return numbers


def guarantees(policy: ls.NetworkPolicy, target: np.ndarray) -> list[dict[str, Any]]:
    """The proved bounds on the visible neurons, |factor e| exp(-rate t), that are least at some time of the way."""
    network, seen = policy.network, slice(6 * policy.network.n_visible)
    off = (policy.xi - network.goal(policy.arm.encode(target))).ravel()
    bounds = network.robustness(np.arange(off.size)).guarantees
    factors = [g.overshoot * (1.0 + 1e-9) * np.linalg.norm(g.inverse[seen], 2) * g.factor for g in bounds]
    rates = np.array([g.rate for g in bounds])
    sizes = np.linalg.norm(np.array(factors) @ off, axis=1)
    least = np.unique(np.argmin(np.log(sizes) - rates * np.linspace(0.0, 60.0, 600)[:, None], axis=1))
    return [{"rate": rates[k], "factor": factors[k].tolist()} for k in least]


def clearance(policy: ls.NetworkPolicy, target: np.ndarray) -> str:
    """What is proved of the distance from contact on the way to the first target, as the live view proves it."""
    way = foreseen(policy.arm, policy, None, Progress.of(policy).towards(target), policy.q, target)
    assert way is not None
    found = ClearanceMonitor(policy.arm, *way).clearance
    assert found.proved
    return f"{1e3 * found.bound:.2g} mm"


def geoms(model: mujoco.MjModel) -> list[dict[str, Any]]:
    """What is drawn: shapes with their sizes, or with triangles ``(9 f,)``, and colours."""
    drawn = []
    for k in range(model.ngeom):
        geom, material = model.geom(k), int(model.geom_matid[k])
        if geom.group[0] > 2 or geom.name in NOT_DRAWN:
            continue
        shape = mujoco.mjtGeom(int(geom.type[0])).name.removeprefix("mjGEOM_").lower()
        size = geom.size
        if shape == "mesh":
            mesh = model.mesh(int(geom.dataid[0]))
            first, count = int(mesh.faceadr[0]), int(mesh.facenum[0])
            vertices = model.mesh_vert[int(mesh.vertadr[0]) :]
            size = vertices[model.mesh_face[first : first + count]].ravel()
        colour = geom.rgba if material < 0 else model.mat_rgba[material]
        look = {"rgba": colour.round(3).tolist(), "size": size.round(5).tolist()}
        drawn.append({"id": k, "body": int(geom.bodyid[0]), "shape": shape, **look})
    return drawn


def box_of(arm: ls.Arm) -> dict[str, Any]:
    """Where the target may be dragged: behind the window, or above the floor; half sizes, and a frame by columns."""
    frame, half = np.eye(4), np.array([1.6, 2.0, 0.9])
    frame[3, :3] = 0.9, 0.0, 1.1
    if (site := mujoco.mj_name2id(arm.model, mujoco.mjtObj.mjOBJ_SITE, "obstacle_goal0")) >= 0:
        data = mujoco.MjData(arm.model)
        mujoco.mj_kinematics(arm.model, data)
        frame[:3, :3], frame[3, :3] = data.site_xmat[site].reshape(3, 3).T, data.site_xpos[site]
        half = arm.model.site_size[site]
    return {"frame": frame.ravel().tolist(), "half": half.tolist()}


def scene_of(name: str) -> dict[str, Any]:
    """All that the page needs of a scene."""
    policy, target = policy_of(name)
    arm, certificate = policy.arm, policy.network.certificate
    model, names = arm.model, [arm.model.site(k).name for k in range(arm.model.nsite)]
    return {
        "name": name,
        "push": SCENES[name].push,
        "about": SCENES[name].about.format(clearance=clearance(policy, target)),
        # MuJoCo's WebAssembly build is older than its Python package, and refuses to be told this default.
        "xml": arm.copied_spec().to_xml().replace(' input="pos"', ""),
        **exported(policy),
        "guarantees": guarantees(policy, target),
        "proof": f"certified for every target: \u03bb\u2098\u2090\u2093 {certificate.lambda_max:.3g} "
        f"< \u03b3/\u03bc {certificate.bound:.3g}",
        "home": arm.keyframe("home").tolist(),
        "target": target.tolist(),
        # Near which the joints stay as the ball is dragged.
        "posture": (arm.keyframe("home") if name == "free" else target).tolist(),
        "step": arm.timestep,
        # Of a servo, over its stiffness [s].
        "damping": (model.actuator_biasprm[:, 2] / model.actuator_biasprm[:, 1]).tolist(),
        "last": int(model.site_bodyid[names.index("link4_frame")]),
        "tip": names.index("link4_frame"),
        "box": box_of(arm),
        "geoms": geoms(model),
    }


def packed(content: bytes) -> str:
    """Compressed, as text."""
    return base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()


def write(page: Path) -> None:
    """Write the page; `FileNotFoundError` without npm, `subprocess.CalledProcessError` where that fetches nothing."""
    WORK.mkdir(parents=True, exist_ok=True)
    lock, marker = HERE / "package-lock.json", WORK / "node_modules" / "made-of.json"
    if not marker.exists() or marker.read_bytes() != lock.read_bytes():
        for name in ("package.json", "package-lock.json"):
            shutil.copy(HERE / name, WORK)
        subprocess.run(["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--silent"], cwd=WORK, check=True)
        shutil.copy(lock, marker)
    for source in ("page.js", "policy.js"):
        shutil.copy(HERE / source, WORK)
    packages = WORK / "node_modules"
    options = ("--bundle", "--minify", "--format=esm", "--target=es2022", "--external:module", "--log-level=warning")
    join = [packages / ".bin" / "esbuild", "page.js", *options, "--legal-comments=none"]
    script = subprocess.run(join, cwd=WORK, check=True, stdout=subprocess.PIPE, text=True).stdout
    scenes = {name: scene_of(name) for name in SCENES}
    parts = {
        "WASM": packed((packages / "@mujoco" / "mujoco" / "mujoco.wasm").read_bytes()),
        "SCENES": packed(json.dumps(scenes, allow_nan=False).encode()),
        "SCRIPT": script.replace("</script", "<\\/script"),
        "MIT": (packages / "three" / "LICENSE").read_text(encoding="utf-8"),
        "APACHE": (ROOT / "LICENSE").read_text(encoding="utf-8"),
    }
    for name, version in json.loads((HERE / "package.json").read_text())["dependencies"].items():
        parts[name.rpartition("/")[2].upper()] = version
    text = (HERE / "page.html").read_text(encoding="utf-8")
    page.write_text(re.sub(r"@([A-Z]+)@", lambda found: parts[found[1]], text), encoding="utf-8")


def write_or_say_why_not(page: Path) -> None:
    """Write the page, or where npm cannot give its packages a page that says so, and a line in the log."""
    page.parent.mkdir(parents=True, exist_ok=True)
    try:
        write(page)
    except (FileNotFoundError, subprocess.CalledProcessError) as error:
        why = "npm is not installed" if shutil.which("npm") is None else f"its packages could not be fetched ({error})"
        say = f"This page was left out when the site was built: {why}. Install npm and build the site again."
        print(f"docs: {page.name}: {say}", file=sys.stderr)
        page.write_text(f"<!doctype html><meta charset=utf-8><title>Left out</title><p>{escape(say)}</p>", "utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
