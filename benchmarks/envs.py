"""Simulation speed: the bare simulators, our environments and the public ones, in one table.

`python -m benchmarks.envs` times all contenders in turn, many times over, with the same actions
within a repetition. The time is the processor's, and shares are medians of the repetitions' own,
so what else runs on the machine matters little; only threads are timed by the clock, and need a
machine that does nothing else.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial

from tqdm import tqdm

from benchmarks import bullet, humanoids
from benchmarks.measurement import head

MEASUREMENTS = {
    **{body: partial(bullet.measurement, body) for body in bullet.PEERS},
    **{body: partial(humanoids.measurement, body) for body in ("Humanoid", "Atlas")},
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the table and what it means, and return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.envs", description=__doc__)
    parser.add_argument(
        "--bodies", nargs="+", default=list(MEASUREMENTS), choices=list(MEASUREMENTS)
    )
    parser.add_argument("--envs", nargs="+", type=int, help="numbers of environments")
    parser.add_argument("--repetitions", type=int, default=20)
    options = parser.parse_args(arguments)
    sizes = [options.envs] if options.envs else []
    measurements = [MEASUREMENTS[body](*sizes) for body in options.bodies]
    for seed in tqdm(range(options.repetitions), desc="repetitions"):
        for measurement in measurements:
            measurement.repeat(seed)
    print(head())
    for measurement in measurements:
        print(measurement.table())
    print("Rates: steps of one body per second of processor time, with threads per second.")
    for measurement in measurements:
        print(measurement.verdict())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
