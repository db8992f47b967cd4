"""Pictures of a body."""

from __future__ import annotations

import numpy as np

from silem.envs.simulator import Simulator


class Camera:
    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator

    def picture(self) -> np.ndarray:
        raise NotImplementedError
