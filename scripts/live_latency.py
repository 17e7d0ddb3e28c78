"""How soon the live view answers: drags its target many times while the page is open, and prints times and rates.

    python scripts/live_latency.py --drags 1000

Every drag moves the target by some centimetres; its time ends with the first control period in which the reference
moves towards it. Wall times, so nothing else should run.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import lieednn_sim as ls


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arm", default="telescopic_pr")
    parser.add_argument("--drags", type=int, default=1000)
    parser.add_argument("--policy", default="lieednn-shaped")
    parser.add_argument("--port", type=int, default=0, help="open this port in a browser to measure beside one")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    begun, cpu = time.perf_counter(), time.process_time()
    with ls.view(arguments.arm, policy=arguments.policy, target="home", port=arguments.port, browser=False) as page:
        session = page.session
        print(f"{page.url} after {time.perf_counter() - begun:.2f} s, {time.process_time() - cpu:.2f} s of CPU time")
        while session.tick.policy != arguments.policy:
            time.sleep(0.01)
        centre, answers, refused = session.aimed.position, list[float](), 0
        begun, cpu, before = time.perf_counter(), time.process_time(), session.tick.time
        for _ in range(arguments.drags):
            old, asked = session.tick.target, time.perf_counter()
            session.aim(centre + rng.uniform(-0.1, 0.1, 3))
            while session.tick.target is old and not session.aimed.problem:
                time.sleep(0.0005)
            if session.aimed.problem:
                refused += 1
            else:
                answers.append(time.perf_counter() - asked)
            time.sleep(0.02)
        spent, done = time.perf_counter() - begun, session.tick.time - before
    low, median, high = 1e3 * np.quantile(answers, [0.05, 0.5, 0.95])
    used = (time.process_time() - cpu) / spent
    print(f"{len(answers)} drags answered in {median:.1f} ms in the median, {low:.1f} to {high:.1f} ms for nine in ten")
    print(f"{refused} targets were out of reach; the slowest answer took {1e3 * max(answers):.1f} ms")
    print(f"the loop ran at {100 * done / spent:.1f} Hz, and the process took {used:.2f} s of CPU time per second")


if __name__ == "__main__":
    main()
