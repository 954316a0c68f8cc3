#!/usr/bin/env python3
"""A fleet's history on Spark.

    pip install ./python pyarrow pandas pyspark     # and Java 17
    python examples/fleet/spark_fleet.py DATA RESULTS

Both folders must have the same names on every executor, and the wheel must be installed there. Spark does the months of a
worker that dies again.
"""

import json
import os
import sys
from pathlib import Path

import pandas as pd
from pyspark.sql import SparkSession

from fleet import assess_month, plan

SAID = "loop string, month string, state string, windows long, cpu_s double"


def run(spark, data, results, **settings):
    """Does all that is to be done; a DataFrame of what became of each month."""
    spark.sparkContext.addPyFile(str(Path(__file__).with_name("fleet.py")))
    tasks = pd.DataFrame(list(plan(data, results)), columns=["loop", "folder", "month"])

    def one(group):
        task = tuple(group.iloc[0][["loop", "folder", "month"]])
        return pd.DataFrame([assess_month(data, results, task, **settings)])

    # A partition a month, or as good as: Spark would put small ones together, and one worker would do them all.
    asked = spark.createDataFrame(tasks).repartition(max(1, len(tasks)), "loop", "month")
    return asked.groupBy("loop", "month").applyInPandas(one, SAID)


if __name__ == "__main__":
    # Else workers take whatever python3 is found first.
    os.environ.setdefault("PYSPARK_PYTHON", sys.executable)
    builder = SparkSession.builder.appName("fleet").config("spark.sql.adaptive.coalescePartitions.enabled", "false")
    session = builder.getOrCreate()
    for said in run(session, sys.argv[1], sys.argv[2]).collect():
        print(json.dumps(said.asDict()), flush=True)
    session.stop()
