#!/usr/bin/env python3
"""A fleet's history on the cores of one machine.

    pip install ./python pyarrow
    python examples/fleet/pool_fleet.py DATA RESULTS [WORKERS]

A worker that dies (killed, out of memory) takes its pool with it; a new one goes on with what is not done.
"""

import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import get_context

from fleet import assess_month, plan

# Months at a time, and pools that may break in a row without one of them done.
AT_ONCE = 10_000
PATIENCE = 3


def run(data, results, workers=None, **settings):
    """Does all that is to be done; yields what became of each month."""
    tasks = plan(data, results)
    while left := set(islice(tasks, AT_ONCE)):
        broken = 0
        while left:
            with ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn")) as pool:
                asked = {pool.submit(assess_month, data, results, task, **settings): task for task in sorted(left)}
                try:
                    for future in as_completed(asked):
                        yield future.result()
                        left.remove(asked[future])
                        broken = 0
                except BrokenProcessPool:
                    broken += 1
            if broken > PATIENCE:
                raise RuntimeError(f"workers die again and again; not done: {sorted(left)[:5]}, {len(left)} in all")


if __name__ == "__main__":
    for said in run(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:4])):
        print(json.dumps(said), flush=True)
