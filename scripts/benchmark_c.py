"""The row of the benchmark on a network as C code: the time of its steps, the longest one included."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from benchmark_timing import Row

from lieednn_sim.synthesis import synthesize

_NEURONS = 16
# The thread's own clock, which stands still while another program has the processor.
_MAIN = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>
#include "lieednn.h"

static lieednn net;

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return 1e6 * (double)time.tv_sec + 1e-3 * (double)time.tv_nsec;
}

int main(void)
{
    lieednn_init(&net);
    for (int k = 0; k < LIEEDNN_SIZE; k++) net.x[k] = 0.0;
    for (long step = 0; step < STEPS; step++) {
        double begun = now();
        lieednn_step(&net, 0.01);
        printf("%.3f\\n", now() - begun);
    }
    return 0;
}
"""


def code_rows(scale: int) -> list[Row]:
    """Time of a step of 16 neurons in C, measured 100,000 / ``scale`` times; nothing where there is no C compiler."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        return []
    target = np.random.default_rng(0).uniform(-0.8, 0.8, (_NEURONS, 6))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        synthesize(target).unwrap().to_c(folder)
        (folder / "main.c").write_text(_MAIN, encoding="utf-8")
        steps = f"-DSTEPS={max(100_000 // scale, 10)}"
        sources = [folder / "main.c", folder / "lieednn.c"]
        subprocess.run([compiler, "-std=c99", "-O2", steps, *sources, "-o", folder / "main", "-lm"], check=True)
        times = subprocess.run([folder / "main"], check=True, capture_output=True, text=True).stdout.split()
    return [Row(f"step of a network of {_NEURONS} neurons in C [us]", list(map(float, times)), "<= 20")]
