"""Measurements of speed: `python -m benchmarks.envs`, `python -m benchmarks.training`."""
