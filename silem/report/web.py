"""What the pages that can be played with read: files that a script tag loads from the disk.

A page opened from the disk may fetch nothing, but it may load scripts. A pack is therefore a script
that holds bytes: ``silem.packs[name] = "<base64>"``. `write` puts all packs beside the pages.

A body's pack is binary: the header's length in bytes as little-endian uint32, a JSON header, and
float32 values, little-endian: the observation's mean and scale, then weights (out, in) and biases
of each layer of the policy, then its log standard deviations.
"""

import base64
import dataclasses
import gzip
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np

from silem import bodies
from silem.algorithms.networks import CLIP
from silem.bodies import MujocoBody, humanoid
from silem.report import results, style
from silem.report.pages import slider
from silem.study.evaluate import load_policy
from silem.util import files
from silem.util.errors import SilemError
from silem.util.paths import REPO

BODIES = {
    "Humanoid": "silem_Humanoid_from_cmu_08_01_book_s0_b5918e5b",
    "HumanoidR": "silem_HumanoidR_from_cmu_08_01_book_s0_221849b0",
}
"""The bodies to push, and the run whose policy moves each."""

NPM_PACKAGE = "@mujoco/mujoco", "3.14.0"
"""MuJoCo's own WebAssembly build at npm, and its version."""
NPM_SHA256 = "f845a07ab81303cc6579fec07136818bed21d44a31c1911340f61e06f4d11eee"


def pack(name: str, data: bytes) -> str:
    """Return the script that holds a pack."""
    return f"silem.packs[{json.dumps(name)}] = {json.dumps(base64.b64encode(data).decode())};\n"


def body_pack(name: str) -> bytes:
    """Return a body with the policy that moves it, as a binary (see the module).

    The model in it has no scaled arm: the page scales both as `silem.bodies.humanoid.model` does.
    """
    body, run = bodies.of_kind(name, MujocoBody), results.find(BODIES[name])
    policy: Any = load_policy(run)
    mean, scale = policy.features_extractor.mean_and_scale(np.dtype(np.float32))
    layers = [*policy.mlp_extractor.policy_net[::2], policy.action_net]
    arrays = [mean, scale]
    for layer in layers:
        arrays += [layer.weight.detach().numpy(), layer.bias.detach().numpy()]
    arrays.append(policy.log_std.detach().numpy())
    header = {
        "body": name,
        "run_id": run.run_id,
        "layers": [list(layer.weight.shape) for layer in layers],
        "clip": CLIP,
        "n_substeps": body.n_substeps,
        "standing_pose": list(body.standing_pose),
        "fall_head_m": body.fall_head_m,
        "target_speed_m_s": body.target_speed_m_s,
        "arms": humanoid.ARM_FACTORS if body.varied else humanoid.UNSCALED,
        "skeleton": dataclasses.asdict(body.skeleton),
        "model": humanoid.model(),
    }
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    values = np.concatenate([array.ravel() for array in arrays]).astype("<f4").tobytes()
    return len(text).to_bytes(4, "little") + text + values


def physics(cache: Path) -> dict[str, bytes] | None:
    """Return the program and the compressed WebAssembly of MuJoCo's npm package.

    It is fetched once with ``npm pack`` and kept in a folder; None where that cannot be done.

    Raises:
        SilemError: The package is not the one that the checksum names.
    """
    name, version = NPM_PACKAGE
    archive = cache / f"mujoco-wasm-{version}.tgz"
    if not archive.exists():
        npm, environment = shutil.which("npm"), os.environ | {"npm_config_fetch_retries": "0"}
        with tempfile.TemporaryDirectory() as folder:
            command = [npm or "", "pack", f"{name}@{version}", "--pack-destination", folder]
            if not npm or subprocess.run(command, env=environment, capture_output=True).returncode:
                print(f"note: no {name} from npm: its page shows a film", file=sys.stderr)
                return None
            (fetched,) = Path(folder).glob("*.tgz")
            files.write_bytes(archive, fetched.read_bytes())
    if files.sha256(archive) != NPM_SHA256:
        raise SilemError(f"{archive} is not {name} {version}: its SHA-256 is not {NPM_SHA256}")
    with tarfile.open(archive) as opened:
        members = {member: opened.extractfile(f"package/{member}") for member in _MEMBERS}
        read = {member: found.read() for member, found in members.items() if found}
    return {member: gzip.compress(data, 9, mtime=0) for member, data in read.items()}


_MEMBERS = ("mujoco.js", "mujoco.wasm")


def write(folder: Path, cache: Path = REPO / "_build" / "npm") -> None:
    """Write every pack into a folder, and what the pages must know of them into ``packs.js``.

    The middle picture of each film becomes its poster, beside it in the folder above.
    """
    mujoco, sizes = distribution("mujoco"), {}
    packs = {f"body-{name}": body_pack(name) for name in BODIES}
    packs |= {"learning": slider.learning_pack()} | (physics(cache) or {})
    for name, data in packs.items():
        text = pack(name, data)
        sizes[name] = len(text)
        files.write_text(folder / f"{name}.js", text)
    if "mujoco.wasm" in packs:
        licence = "mujoco-3*.dist-info/licenses/LICENSE"
        (found,) = [p for p in mujoco.files or () if p.match(licence)]
        files.write_text(folder / "mujoco-LICENSE.txt", found.read_text())
    films = REPO / "book" / "_static"
    for path in films.rglob("*.mp4"):
        about_film = imageio.immeta(path)
        middle = int(about_film["duration"] * about_film["fps"] / 2)
        poster = imageio.imwrite("<bytes>", imageio.imread(path, index=middle), extension=".jpg")
        files.write_bytes((folder.parent / path.relative_to(films)).with_suffix(".jpg"), poster)
    about = {"version": NPM_PACKAGE[1], "mujoco_python": mujoco.version, "sizes": sizes}
    files.write_text(folder / "packs.js", f"silem.about = {json.dumps(about)};\n")


def finish(html: Path) -> None:
    """Tell the built pages which of their figures show the paper's numbers."""
    pictures = sorted((html / "_images").glob("*.svg"))
    mark = f'id="{style.WITHOUT_GHOSTS}"'
    names = [path.name for path in pictures if mark in path.read_text()[:400]]
    text = f"silem.withPaper = {json.dumps(names)};\n"
    files.write_text(html / "_static" / "web" / "figures.js", text)
