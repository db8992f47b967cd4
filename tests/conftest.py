"""Shared by all tests: one thread, and a generator with a fixed seed."""

from __future__ import annotations

import os
import signal

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
import pytest
import torch as th

import silem.util.offscreen  # noqa: F401  before a test imports MuJoCo, which then draws by it

th.set_num_threads(1)

# A shell's background job is born deaf to Ctrl-C, and so are its children; the tests send it.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def rng() -> np.random.Generator:
    """A fresh generator, the same in every test."""
    return np.random.default_rng(0)
