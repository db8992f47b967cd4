"""Measurements of speed: `python -m benchmarks.envs`, `python -m benchmarks.training`."""

import silem  # noqa: F401  before NumPy is: it sets the number of threads, on which all rests
