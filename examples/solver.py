#!/usr/bin/env python3
"""A solver of your own for stictiond: stictiond analyze FILE --solver "cmd:python3 examples/solver.py"

stictiond writes one JSON line: the span s0, bounds, constraints, how many evaluations are allowed, a seed, and the bands
that its own search found, for those who want to start there. Then, for
every line "fs fd" that this program writes, it answers with the mean squared error of the best process behind such a
valve ("inf" where the stem hardly moves, or outside the constraints). The best pair counts; ending the output ends it.

Here: simulated annealing, from three starts.
"""

import json
import math
import random
import sys


def main():
    task = json.loads(sys.stdin.readline())
    span, limit = task["s0"], task["evaluations"]
    draw = random.Random(task["seed"])

    def error(fs, fd):
        print(fs, fd, flush=True)
        return float(sys.stdin.readline())

    def into_the_triangle(fs, fd):
        fd = max(fd, 0.0)
        fs = max(fs, fd)
        shrink = min(1.0, span / max(fs + fd, 1e-12))
        return fs * shrink, fd * shrink

    starts, steps = 3, min(limit, 1500) // 3
    for _ in range(starts):
        candidates = [into_the_triangle(span * draw.random(), 0.5 * span * draw.random()) for _ in range(steps // 4)]
        here, cost = min(((c, error(*c)) for c in candidates), key=lambda pair: pair[1])
        for step in range(steps - len(candidates)):
            share = 1.0 - step / steps
            reach = 0.15 * span * share**2 + 1e-3 * span
            there = into_the_triangle(here[0] + draw.gauss(0, reach), here[1] + draw.gauss(0, reach))
            found = error(*there)
            temperature = 0.2 * share**3 + 1e-6
            if found < cost or draw.random() < math.exp((cost - found) / (temperature * max(cost, 1e-12))):
                here, cost = there, found


main()
