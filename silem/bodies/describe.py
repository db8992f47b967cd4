"""What a body is made of, as the simulator has it rather than as the model file says."""

from __future__ import annotations
