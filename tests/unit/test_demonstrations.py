"""Demonstrations with extra arrays, and the manifest of the published ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from silem.motion import demonstrations as demos
from silem.motion.demonstrations import Demonstrations
from silem.util import files
from silem.util.errors import SilemError


def test_extra_arrays_travel_with_the_features(tmp_path: Path) -> None:
    features = (np.zeros((3, 2), np.float32), np.ones((4, 2), np.float32))
    extra = {"points": np.arange(7 * 6.0).reshape(7, 2, 3)}
    demonstrations = Demonstrations(features, (1.0, 2.0), "HC0", extra=extra)
    demonstrations.save(tmp_path / "d.npz")
    there = Demonstrations.load(tmp_path / "d.npz")
    assert np.array_equal(there.extra["points"], extra["points"])
    assert np.array_equal(there.features[1], features[1])
    assert there.returns == (1.0, 2.0)
    assert np.array_equal(there.first(1).extra["points"], extra["points"][:3])
    for bad in ({"points": np.zeros((6, 3))}, {"returns": np.zeros(7)}):
        with pytest.raises(SilemError, match="allowed: 7 rows"):
            Demonstrations(features, extra=bad)


def test_publishing_needs_no_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    there = Demonstrations.from_arrays([np.zeros((3, 2))])
    demos.publish("clip", there, {"source": "a page"})
    entry = demos.entry("clip")
    assert (entry["return_mean"], entry["source"]) == (None, "a page")
    assert entry["sha256"] == files.sha256(tmp_path / "demonstrations" / "clip.npz")
    with pytest.raises(SilemError, match=r"unknown demonstrations 'dance'; allowed: .*clip"):
        demos.entry("dance")


def test_the_clips_come_with_the_package_and_experts_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    assert Demonstrations.load("cmu_08_01").n_features == 23
    assert demos.entry("cmu_08_01_on_Atlas")["body"] == "Atlas"
    assert not demos.file_of("HC0").exists()
    mine = Demonstrations.from_arrays([np.zeros((3, 2))])
    assert demos.publish("cmu_08_01", mine).is_relative_to(tmp_path)  # and then goes before
    assert Demonstrations.load("cmu_08_01").n_features == 2
    assert demos.entry("cmu_08_01")["n_features"] == 2
