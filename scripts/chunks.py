# /// script
# requires-python = ">=3.11,<3.14"
# dependencies = ["lieednn_sim", "ruckig>=0.19,<1", "torch>=2.10,<3"]
# ///
"""Test `lieednn-chunks` with clean and faulty chunks of joint targets, and with policies in closed loop.

    pip install 'ruckig>=0.19,<1' 'torch>=2.10,<3'
    python scripts/chunks.py [--chunks 200] [--episodes 20] [--policies expert clone] [--jobs 2]

Only the clone needs torch. Finished runs are kept in ``OUTPUT/runs`` and not repeated, so that an interrupted study
goes on. Writes ``chunks.md``; CPU times are those of one core with one BLAS thread.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from functools import cache
from importlib import metadata
from itertools import product
from pathlib import Path
from typing import Any

import chunk_policies as policies
import numpy as np
from chunk_policies import DT, PERIOD, REFERENCES, H
from common import options, saved_runs, write

import lieednn_sim as ls
from lieednn_sim import io
from lieednn_sim.environments.tasks import band_limited, make_task
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.policies import ChunkPolicy
from lieednn_sim.registry import DEFAULT_ARMS
from lieednn_sim.values import Floats, rounded

CLEAN = ("clean, no delay", "clean", "clean, 0.8 s late")
FAULTS = (
    *("jump inside", "jump at the seam", "speed", "acceleration", "limits", "not a number", "wrong shape"),
    *("stale", "outlier", "noise", "contact"),
)
# Kinds for which the reference should follow the clean chunk; and the faults of the expert's chunks.
FOLLOWED, PLAYED = (*CLEAN, "outlier", "noise"), ("jump inside", "jump at the seam", "speed", "outlier", "noise")
SCENE, TASKS = "poles", ("reach", "track")
DELAYS, EVERY = (0.0, 0.2, 0.8), 0.4  # of inference, and time between two chunks [s]
FIRST_SEED = 10**6  # of the episodes
HEADINGS = ("task, policy", "delay [ms]", "reference", "success [%]", "touching", "jump", "jerk [1/s^3]")


@cache
def room(name: str) -> ls.Arm:
    """An arm among obstacles."""
    return ls.Arm.load(name, scene=SCENE)


def faulty(arm: ls.Arm, kind: str, clean: Floats, dt: float, passed: int, rng: np.random.Generator) -> Floats:
    """A clean chunk ``(H, n)`` with a fault of a kind after its first ``passed`` targets."""
    chunk, (low, high), v = clean.copy(), arm.position_limits.T, arm.velocity_limits
    row, joint = int(rng.integers(passed + 3, len(chunk) - 2)), int(rng.integers(arm.n_joints))
    sign, t = rng.choice([-1.0, 1.0], arm.n_joints), dt * np.arange(len(chunk))
    if kind == "jump inside":
        chunk[row:] += sign * rng.uniform(0.1, 0.3, arm.n_joints) * arm.ranges
    elif kind == "jump at the seam":
        chunk += sign * rng.uniform(0.05, 0.2, arm.n_joints) * arm.ranges
    elif kind == "speed":
        fastest = (np.abs(np.diff(chunk, axis=0)) / dt / v).max()
        chunk += (rng.uniform(1.5, 4.0) / max(fastest, 0.02) - 1.0) * (chunk - chunk[0])
    elif kind == "acceleration":
        w = 2.0 * np.pi * rng.uniform(1.0, 0.25 / dt)
        chunk[:, joint] += rng.uniform(2.0, 8.0) * arm.acceleration_limits[joint] / w**2 * np.sin(w * t)
    elif kind == "limits":
        chunk[:, joint] += high[joint] - chunk[:, joint].max() + rng.uniform(0.05, 0.3) * arm.ranges[joint]
    elif kind == "not a number":
        chunk[row, joint] = rng.choice([np.nan, np.inf])
    elif kind == "wrong shape":
        chunk = chunk[:, :-1] if rng.random() < 0.5 else chunk[0]
    elif kind == "outlier":
        chunk[row, joint] += sign[joint] * rng.uniform(0.1, 0.5) * arm.ranges[joint]
    elif kind == "noise":
        chunk += rng.uniform(5e-4, 2e-3) * arm.ranges * rng.standard_normal(chunk.shape)
    elif kind == "contact":
        part = np.clip((np.arange(len(chunk)) - passed) / (len(chunk) - 1 - passed), 0.0, 1.0)[:, None]
        draws = (clean[-1] + far * arm.ranges * rng.standard_normal(arm.n_joints) for far in np.arange(0.1, 9, 0.05))
        end = next(end for draw in draws if arm.contacts(end := np.clip(draw, low, high)))
        chunk += part**2 * (3.0 - 2.0 * part) * (end - clean[-1])
    return chunk


def judged(kind: str, seed: int) -> dict[str, float]:
    """Send one chunk after a clean one; returns its verdict, and the reference's distance from the clean chunk."""
    arm, rng = room(DEFAULT_ARMS[seed % len(DEFAULT_ARMS)]), np.random.default_rng(seed)
    delay = {CLEAN[0]: 0.0, CLEAN[2]: 0.8}.get(kind, 0.2 * float(rng.integers(5)))
    hz = int(rng.choice([10, 20, 30, 50]))
    count, seam = max(int(rng.integers(16, 65)), int((delay + 0.5) * hz) + 6), round(rng.uniform(0.8, 1.0), 2)
    end = seam - delay + (count - 1) / hz
    while True:
        drawn = band_limited(arm, rng, end)
        if not any(map(len, arm.near_contacts_along(drawn(np.arange(0.0, end, 0.02))))):
            break

    def way(times: Floats) -> Floats:
        """The path of which chunks are parts; it slows down to rest in its last second."""
        x = np.clip(times - (end - 1.0), 0.0, 1.0)
        return drawn(np.clip(times, 0.0, end - 1.0) + x - x**3 + 0.5 * x**4)

    policy, home = ChunkPolicy(arm, 1.0 / PERIOD), arm.keyframe("home")
    policy.reset(home)
    policy.accept(way(np.arange(64.0) / hz), 0.0, 1.0 / hz)
    states = [policy.step(None, home) for _ in range(round(seam / PERIOD))]
    begin = policy.now - delay
    chunk = way(begin + np.arange(count) / hz)
    if kind not in CLEAN:
        chunk = faulty(arm, kind, chunk, 1.0 / hz, int(delay * hz), rng)
    if kind == "stale":
        begin -= end + rng.uniform(0.0, 1.0)
    verdict = policy.accept(chunk, begin, 1.0 / hz)
    off, joined = 0.0, policy.now + verdict.fade
    for _ in range(round((end + 1.0 - seam) / PERIOD)):
        states.append(policy.step(None, home))
        if joined < policy.now < end:
            off = max(off, float(np.abs(states[-1][0] - way(np.array([policy.now]))[0]).max()))
    q, qd = np.array(states).swapaxes(0, 1)
    change = np.abs(np.diff(qd, axis=0, prepend=0.0 * qd[:1])) / PERIOD
    kept = (np.abs(qd) <= arm.velocity_limits + 1e-6).all() and (change <= arm.acceleration_limits + 1e-6).all()
    safe = bool(kept) and bool((arm.limit_excess(q) < 1e-6).all()) and not any(map(arm.contacts, q[::2]))
    refused, found = not verdict.accepted, policy.verdict.findings
    off = -1.0 if refused or any(finding.kind == "unproved" for finding in found) else 1e3 * off
    return {"found": len(found), "refused": refused, "safe": safe, "off": off}


def episode(name: str, policy: str, delay: float, way: str, seed: int, folder: Path) -> dict[str, float]:
    """The figures of one episode of a task, in which the policy sends a chunk every `EVERY` seconds."""
    # The time to reach a target does not depend on the delay.
    longer: dict[str, Any] = {"time_limit": 6.0 + delay} if name == "reach" else {}
    task = make_task(name, control_timestep=PERIOD, **longer)
    task.begin(np.random.default_rng(FIRST_SEED + seed))
    arm, rng, steps, sparse = task.arm, np.random.default_rng(seed), task.steps, round(DT / PERIOD)
    goal, many, reach = task.target(0.0), steps + H * sparse, name == "reach"
    targets = np.array([task.target(PERIOD * k) for k in range(many + 1)])
    ideal = policies.reached(arm, goal, PERIOD, many) if reach else targets[:-1]
    cloned = policies.clone(arm, folder / f"{name}.npz") if policy == "clone" else None
    reference, coming = policies.Reference(arm, way), deque[tuple[int, Floats]]()
    q, ok, touched = [ideal[0]] * 2, list[bool](), False
    spent: dict[bool, list[float]] = {False: [], True: []}
    for k in range(steps):
        if k % round(EVERY / PERIOD) == 0:
            chunk = ideal[k : k + H * sparse : sparse]
            if cloned is not None:
                chunk = cloned(task.command, targets[k + sparse :: sparse][: 1 if reach else H])
            elif k // round(EVERY / PERIOD) % 3 == 1 and k < 4.0 / PERIOD:
                chunk = faulty(arm, str(rng.choice(PLAYED)), chunk, DT, int(delay / DT), rng)
            coming.append((k, chunk))
        measured, new = task.simulation.q, bool(coming) and k >= coming[0][0] + round(delay / PERIOD)
        begin = time.process_time()
        if new:
            made, chunk = coming.popleft()
            reference.accept(chunk, PERIOD * made)
        q.append(reference.step(measured))
        spent[new].append(time.process_time() - begin)
        ok.append(task.step(task.commands.towards(task.command, q[-1]))[4]["success"])
        touched = touched or (k % 5 == 0 and bool(arm.contacts(task.simulation.q)))
    parts = np.array(q) / arm.ranges  # two rows of rest come first
    left = np.linalg.norm(parts - goal / arm.ranges, axis=1)
    behind = [np.square(parts[202:] - ideal[201 - s : steps + 1 - s] / arm.ranges).mean() for s in range(150)]
    return {
        "success": float(ok[-1] if reach else np.mean(ok[200:])),
        "touched": touched,
        "jump": float((np.abs(np.diff(q, n=2, axis=0)) / PERIOD**2 / arm.acceleration_limits).max()),
        "jerk": float(np.sqrt(np.mean(np.square(np.diff(parts, n=3, axis=0))))) / PERIOD**3,
        "lag": 0.0 if reach else 1e3 * PERIOD * int(np.argmin(behind)),
        "back": 100.0 * float((left - np.minimum.accumulate(left)).max() / left[0]) if reach else 0.0,
        "refused": reference.refused,
        **{str(new): 1e3 * float(np.median(times)) for new, times in spent.items()},
    }


def run(job: tuple[Any, ...], count: int, folder: Path) -> list[dict[str, float]]:
    """The runs of a row."""
    if len(job) == 1:
        return [judged(job[0], seed) for seed in range(count)]
    name, policy, delay, way = job
    return [episode(name, policy, delay, way, seed, folder) for seed in range(count)]


def report(found: dict[tuple[Any, ...], list[dict[str, float]]], libraries: str = "") -> list[str]:
    """Both tables, with their explanations."""
    single, closed = [], []
    for job, rows in found.items():
        of = {key: np.array([row[key] for row in rows], dtype=float) for key in rows[0]}
        if len(job) == 1:
            off = of["off"][(of["off"] >= 0.0) & (job[0] in FOLLOWED)]
            single.append([job[0], len(rows), *(f"{(of[key] > 0.0).sum()}" for key in ("found", "refused", "safe"))])
            single[-1] += [f"{np.median(off):.2g}", f"{max(off):.2g}"] if len(off) else ["", ""]
            continue
        name, policy, delay, way = job
        cells = [f"{name}, {policy}", f"{1e3 * delay:.0f}", way, f"{100.0 * of['success'].mean():.0f}"]
        cells += [f"{of['touched'].sum():.0f}", rounded(of["jump"].max()), rounded(float(np.median(of["jerk"])))]
        back = of["back"].max()  # [%]
        cells.append(f"{round(back, int(back < 10.0)):g} %" if name == "reach" else f"{np.median(of['lag']):.0f} ms")
        cells.append(f"{of['refused'].sum():.0f}" if way == REFERENCES[-1] else "")
        closed.append([*cells, f"{np.median(of['True']):.2g} / {np.median(of['False']):.2g}"])
    return [
        "# Chunks of joint targets through `lieednn-chunks`",
        "",
        f"Each row tests one kind of chunk on {', '.join(DEFAULT_ARMS)} in turn, among {SCENE}. A chunk has 16 to 70 "
        "targets at 10 to 50 Hz, arrives 0 to 0.8 s late, and follows a clean one.\n\n- **found**: the verdict names "
        "at least one problem.\n- **safe**: until one second after the chunk's end, the reference keeps the limits of "
        "position, velocity and acceleration, and MuJoCo finds no contact along it, checked every 20 ms.\n- **off**: "
        "the largest joint distance between the reference and the clean chunk, after the transition to the chunk. For "
        "outliers and noise, the clean chunk is the one without them. Refused chunks are left out, and so are those "
        "where the arm waits before a part that is not proved free of contact.",
        *markdown_table(("chunks", "all", "found", "refused", "safe", "off, median [mm, mrad]", "off, worst"), single),
        "",
        f"In closed loop at {1.0 / PERIOD:.0f} Hz, a policy sends a chunk of {H} targets at {1.0 / DT:.0f} Hz every "
        f"{EVERY:g} s, which arrives after the delay. All rows have the same episodes of `TelescopicReach` and "
        "`TelescopicTrack`. They take 6 s, for Reach counted from the arrival of the first chunk. The expert's chunks "
        f"are parts of its motion; of those in the first 4 s every third has a fault ({', '.join(PLAYED)}). The clone "
        f"is a network fitted to {policies.EPISODES} episodes of the expert without faults. The arm follows one of "
        "these references:\n\n- **raw**: the newest chunk, with straight lines between its targets.\n- **low-pass**: "
        f"raw after a first-order filter with a time constant of {policies.TIME_CONSTANT:g} s.\n- **linear blending**: "
        f"raw, blended linearly with the chunk before over {policies.BLEND:g} s.\n- **Ruckig**: a motion to raw's "
        f"position and velocity, planned again in each period, with a jerk limit of {policies.JERK:g}/s times the "
        "acceleration limit.\n- **lieednn-chunks**: the policy of this package.\n\nThe columns:\n\n- **success**: for "
        "Reach, the percentage of episodes that end at rest within 1 mm and 0.1 degrees of the target; for Track, the "
        "percentage of the time from 2 s on within 5 mm and 0.5 degrees of it.\n- **touching**: episodes in which the "
        "arm touches something.\n- **jump**: the largest change of the reference's velocity in a period, as a multiple "
        "of what the acceleration limit allows.\n- **jerk**: the root mean square of the reference's jerk, with joints "
        "in units of their ranges; median of the episodes.\n- **lag or back**: for Track, the delay of the target at "
        "which it fits the reference best; median. For Reach, the largest distance by which the reference goes back "
        "from the goal, as a part of the distance at the start.\n- **refused**: chunks that are not executed.\n- "
        f"**CPU**: the time of a control step with a new chunk, and without one.{libraries}",
        *markdown_table((*HEADINGS, "lag or back", "refused", "CPU, new chunk / none [ms]"), closed),
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Do the runs that are missing, and write the tables."""
    known = ("expert", "clone")
    defaults: dict[str, Any] = {"chunks": 200, "episodes": 20, "policies": known, "jobs": 2}
    given = options(arguments, __doc__, "results/chunks", choices={"policies": known}, **defaults)
    folder = io.make_directory(given.output / "runs")
    counts: dict[tuple[Any, ...], int] = {(kind,): given.chunks for kind in (*CLEAN, *FAULTS)}
    counts |= dict.fromkeys(product(TASKS, given.policies, DELAYS, REFERENCES), given.episodes)
    used = f"\n\nVersions: Ruckig {metadata.version('ruckig')}"
    if "clone" in given.policies:
        fits = {f"fit-{name}": (name, folder / f"{name}.npz") for name in TASKS}
        saved_runs(folder, fits, policies.fit, given.jobs)
        used += f", torch {metadata.version('torch')}"
    runs = {"-".join(map(str, job)).replace(" ", "_"): (job, count, folder) for job, count in counts.items()}
    found = dict(zip(counts, saved_runs(folder, runs, run, given.jobs), strict=True))
    write(given.output / "chunks.md", report(found, f"{used}."))


if __name__ == "__main__":
    main()
