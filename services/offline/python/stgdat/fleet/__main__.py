"""The command line of `python -m stgdat.fleet`."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Dict, List, Optional, Sequence, Tuple

from . import Options, Place, run, work
from .inputs import PATTERNS
from .jobs import Job
from .jobs.audit import Audit
from .jobs.evaluate import Evaluate
from .jobs.mine import Mine
from .jobs.priors import Priors
from .jobs.replay import Replay

_JOBS = {
    "evaluate": "Compare forecasts with the observed motion",
    "replay": "Compare this build, or other weights, with the forecasts in records",
    "audit": "Collect the doubts of the input audit",
    "priors": "Learn evidence priors of your roads for `--set sampler.prior=FILE`",
    "mine": "Find the worst ticks and cut them out as small recordings",
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m stgdat.fleet", description="Jobs over many recordings.")
    jobs = parser.add_subparsers(dest="job", required=True, metavar="JOB")
    for name, about in _JOBS.items():
        job = jobs.add_parser(name, help=about, description=about)
        _common(job)
        if name == "evaluate":
            job.add_argument("--positions", action="store_true", help="derive velocities and headings from positions")
        if name == "replay":
            job.add_argument("--before", metavar="FILE", help="weights to compare with, for files that are no records")
        if name == "mine":
            job.add_argument("--count", type=int, default=10, help="scenes for each criterion (10)")
            job.add_argument(
                "--around",
                type=_pair,
                default=(5.0, 5.0),
                metavar="S,S",
                help="seconds of a scene before and after its tick (5,5)",
            )
    return parser


def _common(job: argparse.ArgumentParser) -> None:
    add = job.add_argument
    add(
        "paths",
        nargs="+",
        metavar="PATH",
        help="recordings, records, folders, fsspec addresses, or @FILE with a path per line",
    )
    add(
        "--output",
        required=True,
        metavar="DIR",
        help="folder of the results, which all workers reach; a job that was broken off resumes from it",
    )
    add(
        "--address",
        default=os.environ.get("RAY_ADDRESS"),
        help="cluster of Ray: auto, ray://HOST:PORT, or local; without it, processes of this machine",
    )
    add("--processes", type=int, metavar="N", help="processes of this machine, one per core if not given")
    add(
        "--task-mib",
        type=float,
        default=Place().task_mib,
        metavar="N",
        help="largest task, in MiB of recordings (%(default)g)",
    )
    add(
        "--pattern",
        action="append",
        metavar="GLOB",
        help=f"files of a folder that are recordings ({', '.join(PATTERNS)})",
    )
    add("--rows", action="store_true", help="write a Parquet file with a row per agent and tick for each recording")
    add("--weights", metavar="FILE", help="weights to use instead of the embedded ones")
    add("--lanes", metavar="FILE", help="Lanelet2 map of the site, along whose lanes vehicles are forecast")
    add("--lanes-origin", metavar="LAT,LON|X,Ym", help="origin of the world frame in that map")
    add("--map", metavar="MAP", help="context map: online, none, or a file of stgdat map")
    add(
        "--set",
        action="append",
        default=[],
        type=_setting,
        metavar="STAGE.OPTION=VALUE",
        help="option of a stage, as of stgdat predict",
    )
    add("--format", help="format of the recordings, detected if not given")
    add("--fps", type=float, help="rate of the frame numbers")
    add("--origin", type=_pair, metavar="X,Y", help="world frame's origin in the recordings' own frame")


def _pair(text: str) -> Tuple[float, float]:
    first, second = map(float, text.split(","))
    return first, second


def _setting(text: str) -> Tuple[str, str]:
    name, sign, value = text.partition("=")
    if not sign:
        raise argparse.ArgumentTypeError(f"{text!r}: expected STAGE.OPTION=VALUE")
    return name, value


def _job(arguments: argparse.Namespace) -> Job:
    settings: Dict[str, object] = dict(arguments.set)
    of = arguments
    options = Options(of.weights, of.lanes, of.lanes_origin, of.map, settings, of.format, of.fps, of.origin, of.rows)
    if of.job == "evaluate":
        return Evaluate(options, of.positions)
    if of.job == "replay":
        return Replay(options, of.before)
    if of.job == "mine":
        return Mine(options, of.count, *of.around)
    return {"audit": Audit, "priors": Priors}[of.job](options)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Runs a job. Returns 0, or 65 if recordings were set aside or the job could not start."""
    of = _parser().parse_args(arguments)
    patterns: List[str] = of.pattern or list(PATTERNS)
    place = Place(of.address, of.processes, of.task_mib, patterns)
    try:
        finished = run(_job(of), of.paths, of.output, place)
    except (ImportError, OSError, TypeError, ValueError, work.OtherBuild) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 65
    print(finished.report.text)
    return 65 if finished.failed else 0


if __name__ == "__main__":
    sys.exit(main())
