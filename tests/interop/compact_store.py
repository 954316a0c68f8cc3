"""Compact stores: scipy reads those of stictiond, and stictiond reads those of scipy and MATLAB."""

import csv
import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat, savemat

from daemon import PROGRAM, ROOT

OP, PV = [1.0, 3.0, 5.0], [2.0, 4.0, 6.0]


def run(*arguments, code=0, text=None):
    command = [PROGRAM, *map(str, arguments)]
    done = subprocess.run(command, input=text, capture_output=True, text=True, cwd=ROOT, timeout=300, encoding="utf-8")
    assert done.returncode == code, (arguments, done.returncode, done.stdout, done.stderr)
    return done


def check_example(path):
    """The toolbox's manual: two loops, every 3 s."""
    store = loadmat(path, simplify_cells=True)
    assert store["int_LoopNumber"] == 2
    loops = store["str_Compact"]
    assert np.array_equal(loops["loop1"]["dbl_Compact_Data"], [[1, 2], [3, 4], [5, 6]])
    assert np.array_equal(loops["loop2"]["dbl_Compact_Data"], [[3, 2], [7, 6], [9, 8]])
    return loops


def test_scipy_reads_the_manuals_example(folder):
    path = Path(folder) / "interactive.mat"
    answers = f"2\n[1;3;5]\n[2;4;6]\n3\nÖlventil\n[3;7;9]\n[2;6;8]\n3\n\n{path}\n"
    run("compact", "new", text=answers)
    loops = check_example(path)
    assert loops["loop1"]["dbl_SamplingTime"] == 3
    assert list(loops["loop1"]["cell_char_TagList"]) == ["loop1.OP", "loop1.PV"]
    assert list(loops["loop1"]["cell_char_TimeStamp"]) == [f"1970-01-01T00:00:0{k}Z" for k in (0, 3, 6)]
    assert "Ölventil" in str(loops["loop1"]["cell_Comment"])
    assert run("compact", "new", text=answers, code=1).returncode == 1, "an existing store is not replaced"

    tables = []
    for name, rows in [("A", [(1, 2), (3, 4), (5, 6)]), ("B", [(3, 2), (7, 6), (9, 8)])]:
        table = Path(folder) / f"{name}.csv"
        with table.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([("op", "pv"), *rows])
        tables.append(table)
    for form in [[], ["--uncompressed"]]:
        path = Path(folder) / f"tables{len(form)}.mat"
        run("compact", "new", *tables, "--ts", "3", "--out", path, *form)
        assert list(check_example(path)["loop2"]["cell_char_TagList"]) == ["B.OP", "B.PV"]


def cells(texts):
    column = np.empty((len(texts), 1), dtype=object)
    column[:, 0] = texts
    return column


def test_what_scipy_writes_is_read(folder):
    stamps = cells([f"05-Jan-2026 08:00:{3 * k:02}" for k in range(3)])
    loop = {
        "dbl_Compact_Data": np.array([OP, PV]).T, "dbl_SamplingTime": 3, "cell_char_TagList": cells(["FIC101.OP", "FIC101.PV"]),
        "cell_char_TimeStamp": stamps, "char_Comment": "by its other name",
    }
    for compressed in (False, True):
        path = Path(folder) / f"scipy{compressed}.mat"
        savemat(path, {"noise": np.arange(2000), "int_LoopNumber": 1, "str_Compact": {"loop1": loop}}, do_compression=compressed)
        shown = json.loads(run("compact", "show", path, "--format", "json").stdout)["loops"][0]
        assert shown["comment"] == "by its other name" and shown["op_tag"] == "FIC101.OP" and shown["ts_s"] == 3
        assert shown["start_ns"] == 1_767_600_000 * 10**9 and shown["samples"] == 3
        for name in ("loop1", "1", "FIC101", "FIC101.PV"):
            table = Path(folder) / "back.csv"
            run("convert", path, table, "--loop", name, "--force")
            rows = list(csv.reader(table.open(encoding="utf-8")))
            assert rows[1:] == [["1767600000", "1", "2"], ["1767600003", "3", "4"], ["1767600006", "5", "6"]], rows
        assert "FIC101.OP" in run("info", path).stdout
    four = Path(folder) / "four.mat"
    savemat(four, {"x": np.arange(9)}, format="4")
    told = run("info", four, code=1).stderr
    assert "version 4" in told and "save -v7" in told, told


class BigEndian:
    """A big-endian writer of version 5, as on a SPARC; numbers in the smallest type, as in MATLAB."""

    @staticmethod
    def element(kind, data):
        if 0 < len(data) <= 4:
            return struct.pack(">HH", len(data), kind) + data.ljust(4, b"\0")
        return struct.pack(">II", kind, len(data)) + data.ljust(-(-len(data) // 8) * 8, b"\0")

    @classmethod
    def matrix(cls, kind, dims, name, content):
        flags = cls.element(6, struct.pack(">II", kind, 0))
        body = flags + cls.element(5, struct.pack(f">{len(dims)}i", *dims)) + cls.element(1, name.encode()) + content
        return struct.pack(">II", 14, len(body)) + body

    @classmethod
    def numbers(cls, rows, name=""):
        columns = [value for column in zip(*rows) for value in column]
        whole = all(float(v).is_integer() and 0 <= v < 256 for v in columns)
        data = bytes(int(v) for v in columns) if whole else struct.pack(f">{len(columns)}d", *columns)
        return cls.matrix(6, (len(rows), len(rows[0])), name, cls.element(2 if whole else 9, data))

    @classmethod
    def text(cls, text):
        return cls.matrix(4, (1, len(text)), "", cls.element(4, text.encode("utf-16-be")))

    @classmethod
    def column(cls, texts):
        return cls.matrix(1, (len(texts), 1), "", b"".join(cls.text(text) for text in texts))

    @classmethod
    def structure(cls, fields, name=""):
        names = b"".join(field.encode().ljust(32, b"\0") for field in fields)
        content = cls.element(5, struct.pack(">i", 32)) + cls.element(1, names) + b"".join(fields.values())
        return cls.matrix(2, (1, 1), name, content)


def test_the_greatest_byte_may_come_first(folder):
    path = Path(folder) / "big.mat"
    data = [[1.5, 2], [3, 4], [float("nan"), 6]]
    loop = BigEndian.structure({
        "dbl_Compact_Data": BigEndian.numbers(data), "dbl_SamplingTime": BigEndian.numbers([[3]]),
        "cell_char_TagList": BigEndian.column(["LIC7.OP", "LIC7.PV"]), "cell_char_TimeStamp": BigEndian.column(["?", "?", "?"]),
        "cell_Comment": BigEndian.column(["Öl"]),
    })
    head = b"MATLAB 5.0 MAT-file, Platform: SOL2".ljust(116) + bytes(8) + b"\x01\x00MI"
    path.write_bytes(head + BigEndian.numbers([[1]], "int_LoopNumber") + BigEndian.structure({"loop1": loop}, "str_Compact"))
    assert loadmat(path)["int_LoopNumber"] == 1, "scipy agrees that it is one"
    done = run("compact", "show", path, "--format", "json")
    shown = json.loads(done.stdout)["loops"][0]
    assert (shown["op_tag"], shown["comment"], shown["missing"], shown["start_ns"]) == ("LIC7.OP", "Öl", [1, 0], None)
    assert "not a time" in done.stderr, "stamps that cannot be read are told"


def test_a_solver_in_python(folder):
    done = run(
        "analyze", ROOT / "recordings" / "sticking.mcap", "--samples", "1,600", "--evaluations", "900", "--format", "json",
        "--solver", f"cmd:{sys.executable} {ROOT / 'examples' / 'solver.py'}",
    )
    answer = json.loads(done.stdout)["solver"]
    assert answer["stopped"] == "complete" and 800 <= answer["evaluations"] <= 900, answer
    assert 0 <= answer["fd"] <= answer["fs"] and answer["fs"] + answer["fd"] <= answer["s0"] * (1 + 1e-9)
    assert answer["mse"] < 1.0 and answer["estimate_mse"] < 0.02, answer
