"""The cost of a step in Python beside `stgdat bench --cost`: `python overhead.py`.

Both play the scene of `stgdat bench` with one thread per stage, alternating for some rounds. A time is the median of the
measured ticks, and a ratio is the median over the rounds, because other programs may slow down single rounds.
`STGDAT_PROGRAM` is the executable `stgdat` of the same version.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Dict, List, Tuple

import stgdat

PROGRAM = os.environ.get("STGDAT_PROGRAM", "stgdat")
WARM_UP = 60
COST_AGENTS = (1, 8, 32, 64, 128)
BEGIN, END = (f"<!-- {mark} overhead.py -->\n" for mark in ("begin", "end"))
STAGES = ("extractor", "encoder", "decoder", "sampler")
ARRAYS = ("ids", "positions_m", "probabilities", "modes_m", "mode_covariances_m2", "best_m", "quality")


def steps_ms(agents: int, ticks: int) -> Tuple[float, float]:
    """Milliseconds of a step, without and with arrays taken from its forecasts."""
    predictor = stgdat.Predictor(settings={f"{stage}.workers": 1 for stage in STAGES})
    scene = stgdat.generate(agents=agents, ticks=WARM_UP + ticks, complete=True)
    alone_ms: List[float] = []
    with_arrays_ms: List[float] = []
    for detections in scene.ticks():
        begin = time.perf_counter()
        forecasts = predictor.step(detections)
        stepped = time.perf_counter()
        for name in ARRAYS:
            getattr(forecasts, name)
        alone_ms.append((stepped - begin) * 1e3)
        with_arrays_ms.append((time.perf_counter() - begin) * 1e3)
    return statistics.median(alone_ms[WARM_UP:]), statistics.median(with_arrays_ms[WARM_UP:])


def bench_ms(ticks: int) -> Dict[int, float]:
    """Milliseconds of all stages in `stgdat bench`, by number of agents."""
    command = [PROGRAM, "bench", "--cost", "--ticks", str(ticks)]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines]
    # A row has the mean number of forecast agents first, and the time with all modes last.
    return dict(zip(COST_AGENTS, (float(row[-1]) for row in rows if row[0].isdigit())))


def child_ms(agents: int, ticks: int) -> Tuple[float, float]:
    """`steps_ms` in a process of its own, as `stgdat bench` is one."""
    command = [sys.executable, __file__, "--child", str(agents), "--ticks", str(ticks)]
    alone_ms, with_arrays_ms = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return alone_ms, with_arrays_ms


def table(kernels: List[str], agents: List[int], rounds: int, ticks: int) -> str:
    """Measures, and writes a row per instruction set and number of agents."""
    text = "| kernels | agents | `stgdat bench`, ms | `step`, ms | ratio | ratio with arrays |\n"
    text += "|---|---:|---:|---:|---:|---:|\n"
    for name in kernels:
        if name:
            os.environ["STGDAT_KERNELS"] = name
        measured: Dict[int, List[Tuple[float, float, float]]] = {count: [] for count in agents}
        for _ in range(rounds):
            bench_by_agents = bench_ms(ticks)
            for count in agents:
                measured[count].append((bench_by_agents[count], *child_ms(count, ticks)))
        for count, times in measured.items():
            bench, step, _ = (statistics.median(each) for each in zip(*times))
            ratios = [[step / bench for step in steps] for bench, *steps in times]
            alone, with_arrays = (statistics.median(each) for each in zip(*ratios))
            text += f"| {name or 'fastest'} | {count} | {bench:.2f} | {step:.2f} | {alone:.3f} | {with_arrays:.3f} |\n"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", default="8,32,128", help=f"among {COST_AGENTS}")
    parser.add_argument("--kernels", default="", help="instruction sets, such as avx512,avx2; else the fastest")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--ticks", type=int, default=50)
    parser.add_argument("--table", type=Path, help="page whose marks of this program get the table")
    parser.add_argument("--child", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child is not None:
        print(json.dumps(steps_ms(arguments.child, arguments.ticks)))
        return
    agents = [int(count) for count in arguments.agents.split(",")]
    text = table(arguments.kernels.split(","), agents, arguments.rounds, arguments.ticks)
    print(text, end="")
    if arguments.table is not None:
        before, rest = arguments.table.read_text().split(BEGIN)
        arguments.table.write_text(before + BEGIN + text + END + rest.split(END)[1])


if __name__ == "__main__":
    main()
