"""Jobs over many recordings: on the cores of one machine, or on a cluster of Ray.

    python -m stgdat.fleet evaluate s3://bucket/drives --output results --address ray://head:10001

Each recording is computed alone, by the same Rust crates as the program. This package finds recordings, distributes
them, stores the result of each, and merges the results. It needs `pip install 'stgdat[fleet]'`.

>>> import stgdat.fleet
>>> done = stgdat.fleet.audit("drives", "results")  # doctest: +SKIP
>>> print(done.report.text)  # doctest: +SKIP
"""

from __future__ import annotations

from typing import Optional

from .driver import Finished, Place, run
from .inputs import Path, Paths
from .jobs import Job, Options, Report
from .jobs.audit import Audit
from .jobs.evaluate import Evaluate
from .jobs.mine import Mine
from .jobs.priors import Priors
from .jobs.replay import Replay


def evaluate(
    paths: Paths,
    output: Path,
    options: Options = Options(),
    positions: bool = False,
    place: Place = Place(),
) -> Finished:
    """Compares forecasts with the observed motion: the tables of `stgdat evaluate` over all recordings."""
    return run(Evaluate(options, positions), paths, output, place)


def replay(
    paths: Paths,
    output: Path,
    options: Options = Options(),
    before: Optional[str] = None,
    place: Place = Place(),
) -> Finished:
    """Compares this build with the forecasts in records, or the weights `before` with those of the options."""
    return run(Replay(options, before), paths, output, place)


def audit(paths: Paths, output: Path, options: Options = Options(), place: Place = Place()) -> Finished:
    """Collects the doubts of the input audit."""
    return run(Audit(options), paths, output, place)


def priors(paths: Paths, output: Path, options: Options = Options(), place: Place = Place()) -> Finished:
    """Learns priors for `--set sampler.prior=FILE`. The folder of a recording is its source."""
    return run(Priors(options), paths, output, place)


def mine(
    paths: Paths,
    output: Path,
    options: Options = Options(),
    count: int = 10,
    before_s: float = 5.0,
    after_s: float = 5.0,
    place: Place = Place(),
) -> Finished:
    """Finds the worst ticks and cuts them out as recordings."""
    return run(Mine(options, count, before_s, after_s), paths, output, place)


__all__ = ["Finished", "Job", "Options", "Place", "Report", "audit", "evaluate", "mine", "priors", "replay", "run"]
