"""Which choices of numerical kernels change a run's bits, and what they cost.

``python -m benchmarks.kernels`` makes two small runs of SILEM, HC0 and Humanoid, once for every
choice in a process of its own, and compares all weights, moments and optimizer states at the end.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CHOICES = {
    "as it is": {},
    "OpenBLAS: Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "NumPy: no AVX-512": {"NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR"},
    "oneDNN: AVX2": {"ONEDNN_MAX_CPU_ISA": "AVX2"},
    "PyTorch: AVX2": {"ATEN_CPU_CAPABILITY": "avx2"},
    "MKL: AVX2": {"MKL_CBWR": "AVX2"},
    "MKL: COMPATIBLE": {"MKL_CBWR": "COMPATIBLE"},
    "glibc: no FMA, no AVX2": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2,-AVX512F"},
}


def small_runs() -> dict[str, str]:
    """Make both runs in a folder of their own; return a hash of each one's state at the end."""
    from silem.study import runs
    from silem.study.config import RunConfig
    from silem.study.runs import CHECKPOINT
    from silem.study.settings import Budget
    from silem.util import files, paths

    published = paths.demonstrations_dir()
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SILEM_DATA_DIR"] = folder
        (Path(folder) / "demonstrations").symlink_to(published)
        for body, n_steps in (("HC0", 256), ("Humanoid", 512)):
            budget = Budget("small", 2, n_steps, 6, 1, 2, 3)
            record = runs.run(RunConfig.create(body, "silem", None, budget), progress=False)
            state, _ = files.read_tensors(record.folder / CHECKPOINT)
            digest = hashlib.sha256()
            for name in sorted(state.keys() - {"curve"}):
                digest.update(state[name].tobytes())
            found[body] = digest.hexdigest()
    return found


def main() -> None:
    """Run the command line."""
    if sys.argv[1:] == ["--once"]:
        began = time.process_time()
        print(json.dumps({**small_runs(), "seconds": time.process_time() - began}))
        return
    reference: dict[str, str | float] = {}
    print(f"{'kernels':24} {'HC0':8} {'Humanoid':9} processor time, s")
    for name, chosen in CHOICES.items():
        command = [sys.executable, "-m", "benchmarks.kernels", "--once"]
        done = subprocess.run(
            command, env=os.environ | chosen, capture_output=True, text=True, check=True
        )
        found = json.loads(done.stdout.splitlines()[-1])
        reference = reference or found
        same = [
            "same" if found[body] == reference[body] else "other" for body in ("HC0", "Humanoid")
        ]
        print(f"{name:24} {same[0]:8} {same[1]:9} {found['seconds']:.2f}", flush=True)


if __name__ == "__main__":
    main()
