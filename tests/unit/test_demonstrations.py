"""Demonstrations with extra arrays, and the manifest of the published ones."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from silem import bodies
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
    there = Demonstrations.of([np.zeros((3, 2))])
    demos.publish("clip", there, {"source": "a page"})
    entry = demos.entry("clip")
    assert (entry["return_mean"], entry["source"]) == (None, "a page")
    assert entry["sha256"] == files.sha256(tmp_path / "demonstrations" / "clip.npz")
    with pytest.raises(SilemError, match=r"unknown demonstrations 'dance'; allowed: .*clip"):
        demos.entry("dance")


def test_ones_own_file_needs_no_manifest_but_an_experts_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    path = demos.file_of("mine")
    Demonstrations((FEATURES,)).save(path)
    assert demos.load_published("mine")[1] == files.sha256(path)
    Demonstrations((FEATURES,), (1.0,), "HC0", "an expert").save(path)
    with pytest.raises(SilemError, match=r"not the file that manifest\.json"):
        demos.load_published("mine")


FEATURES = np.arange(10, dtype=np.float32).reshape(5, 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"features": np.full((5, 2), "x")}, "real numbers"),
        ({"features": FEATURES + 1j}, "real numbers"),
        ({"features": FEATURES > 3}, "real numbers"),
        ({"features": np.zeros((5, 0), np.float32)}, "one F > 0"),
        ({"features": np.full((5, 2), 1e300)}, "NaN or infinity"),
        ({"features": np.float32(1)}, "do not add up"),
        ({"lengths": np.array([5.0])}, "do not add up"),
        ({"lengths": np.array([7, -2])}, "do not add up"),
        ({"lengths": np.array([], int)}, "do not add up"),
        (
            {"lengths": np.array([2**62, 2**62, 2**62, 2**62 + 5])},
            "do not add up",
        ),  # overflows to 5
        ({"returns": np.array(["a"])}, "returns"),
        ({"returns": np.array([1.0, 2.0])}, "2 returns of 1"),
        ({"returns": np.array([np.nan])}, "returns"),
        ({"body": np.zeros(3)}, "no text"),
        ({"points": np.zeros(())}, "'points' has shape"),
    ],
)
def test_no_damage_of_a_demonstrations_file_is_taken(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = tmp_path / "d.npz"
    Demonstrations((FEATURES,), (1.0,), "HC0").save(path)
    assert Demonstrations.load(path).n_features == 2
    files.write_npz(path, files.read_npz(path) | change)
    with pytest.raises(SilemError, match=rf"d\.npz.*{message}"):
        Demonstrations.load(path)


def test_names_and_paths_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SILEM_DATA_DIR", "data")
    Demonstrations([FEATURES.astype(np.float64)]).save("mine.npz")  # in double precision
    assert Demonstrations.load("mine.npz").features[0].dtype == np.float32
    demos.publish("mine", Demonstrations((FEATURES + 1,)))
    for source, plus in (
        ("mine.npz", 0),
        ("./mine.npz", 0),
        ("mine", 1),
        ("data/demonstrations/mine.npz", 1),
    ):
        np.testing.assert_array_equal(Demonstrations.load(source).features[0], FEATURES + plus)
    np.testing.assert_array_equal(demos.load_published("mine")[0].features[0], FEATURES + 1)


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd", "", "x" * 300, "a\0b"])
def test_demonstrations_names_stay_in_their_folder(name: str) -> None:
    with pytest.raises(SilemError, match="demonstrations must be a name"):
        demos.file_of(name)


def test_a_manifest_that_is_none_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    for content in ([], {"HC0": 3}):
        files.write_json(tmp_path / "demonstrations" / demos.MANIFEST, content)
        with pytest.raises(SilemError, match="no manifest"):
            demos.entry("HC0")


def _die_at(step: int, work: Callable[[], object]) -> None:
    """Do some work and die, without any cleaning up, at the n-th thing that reaches the disk."""
    left = [step]

    def deadly(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if not left[0]:
                os._exit(9)
            left[0] -= 1
            return real(*arguments, **options)

        return call

    for name in ("open", "fsync", "replace", "ftruncate", "pwrite"):
        setattr(os, name, deadly(getattr(os, name)))
    files.open = deadly(open)  # type: ignore[attr-defined]
    work()


@pytest.mark.parametrize("before", [None, "another"])
def test_wherever_publishing_is_killed_asking_again_mends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: str | None
) -> None:
    there = Demonstrations((FEATURES,), (1.0,), "HC0", "an expert")

    def ask() -> None:
        with demos.publishing():
            if not demos.is_published("HC0") or demos.entry("HC0")["expert_run_id"] != "an expert":
                demos.publish("HC0", there)

    context = multiprocessing.get_context("fork")
    apart, step, code = 0, 0, 9
    while code:
        folder = tmp_path / str(step)
        monkeypatch.setenv("SILEM_DATA_DIR", str(folder))
        if before:
            demos.publish("HC0", Demonstrations((FEATURES + 1,), (1.0,), "HC0", before))
        process = context.Process(target=_die_at, args=(step, ask))
        process.start()
        process.join(60)
        code = process.exitcode
        path = demos.file_of("HC0")
        apart += path.exists() and not demos.is_published("HC0")
        ask()
        found, sha = demos.load_published("HC0")
        assert found.expert_run_id == "an expert" and sha == files.sha256(path)
        assert sorted(os.listdir(path.parent)) == ["HC0.npz", demos.MANIFEST]
        step += 1
    assert code == 0 and step > 8
    assert apart > 0  # else no kill came between the two writes


def test_the_clips_come_with_the_package_and_experts_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    assert demos.load_published("cmu_08_01")[0].n_features == 23
    assert demos.entry("cmu_08_01_on_Atlas")["body"] == "Atlas"
    assert not demos.file_of("HC0").exists()
    mine = Demonstrations.of([np.zeros((3, 2))])
    assert demos.publish("cmu_08_01", mine).is_relative_to(tmp_path)  # and then goes before
    assert demos.load_published("cmu_08_01")[0].n_features == 2
    assert list(files.read_json(tmp_path / "demonstrations" / demos.MANIFEST)) == ["cmu_08_01"]


def test_long_objects_say_what_they_are_in_one_short_line() -> None:
    whole = Demonstrations.of([np.zeros((1001, 26), np.float32)] * 20)
    assert repr(whole) == "<Demonstrations: 20 trajectories, 20020 states, 26 features>"
    atlas = "<MujocoBody Atlas: Atlas v4 of Boston Dynamics, ankles within +-0.1 rad>"
    assert repr(bodies.get("Atlas")) == atlas
