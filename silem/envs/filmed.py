"""What every environment that can be looked at has in common."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from silem.util.errors import SilemError


class Pictures(Protocol):
    """A camera."""

    def picture(self) -> np.ndarray:
        """Return a picture (H, W, 3), uint8."""


class Filmed:
    """An environment with a camera that is set up when the first picture is wanted.

    Attributes:
        picture_size: Width and height in pixels, to be set before the first picture.
    """

    picture_size: tuple[int, int] = (640, 480)
    _camera: Pictures | None = None

    def _is_reset(self) -> bool:
        """Tell whether there is an episode to go on with."""
        raise NotImplementedError

    def _make_camera(self) -> Pictures:
        """Return a camera on the environment, or on the first of several."""
        raise NotImplementedError

    def _picture(self) -> np.ndarray:
        """Return a picture (H, W, 3), uint8; raises SilemError where there can be none."""
        if not self._is_reset():
            raise SilemError("render before reset")
        if self._camera is None:
            self._camera = self._make_camera()
        return self._camera.picture()
