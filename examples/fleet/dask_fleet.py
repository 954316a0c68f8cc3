#!/usr/bin/env python3
"""A fleet's history on Dask: on a cluster of this machine, or on one whose scheduler is given.

    pip install ./python pyarrow dask distributed
    python examples/fleet/dask_fleet.py DATA RESULTS [WORKERS | tcp://SCHEDULER:8786]

All workers must reach both folders under the same names, and have the wheel. A worker that dies is replaced and its
months are done again, by Dask.
"""

import json
import sys
from itertools import islice

import cloudpickle
from distributed import Client, KilledWorker, LocalCluster, as_completed

import fleet
from fleet import assess_month, plan

# Workers elsewhere do not have that file: its functions go with the months.
cloudpickle.register_pickle_by_value(fleet)
# Months that are handed to the scheduler at a time: it holds some kilobytes of each.
AT_ONCE = 10_000


def run(client, data, results, **settings):
    """Runs every task; yields the result of each month."""
    tasks = plan(data, results)
    while some := list(islice(tasks, AT_ONCE)):
        # `pure=False`: a month that is submitted again is computed again.
        futures = client.map(lambda task: assess_month(str(data), str(results), task, **settings), some, pure=False)
        asked = dict(zip(futures, some))
        for future in as_completed(futures):
            loop, _, month = asked[future]
            try:
                yield future.result()
            except KilledWorker:
                # Every worker that took it died; the others go on.
                yield {"loop": loop, "month": month, "state": "failed", "windows": 0, "cpu_s": 0.0}
            future.release()


def local(workers):
    """A cluster of this machine."""
    return LocalCluster(n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None)


if __name__ == "__main__":
    where = sys.argv[3] if len(sys.argv) > 3 else "2"
    with Client(local(int(where)) if where.isdigit() else where) as client:
        for said in run(client, sys.argv[1], sys.argv[2]):
            print(json.dumps(said), flush=True)
