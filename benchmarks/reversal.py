"""Can TPIL's gradient reversal work at all? A toy where two bodies differ by a known shift.

``python -m benchmarks.reversal`` writes ``data/search/reversal.json``, an entry for each
discriminator as it is done, and goes on with a file that lacks some. A "gait" is a point that
goes round a circle; the expert turns fast, and of the learner's episodes half turn as fast and half
do not (a policy of the expert's quality, and a worse one). The learner's body adds a constant to
two of six features, which single states betray at once. No policy learns here: discriminators do,
and what counts is whether their reward tells the learner's good windows from its bad ones
(``ranking``, the share of pairs in which the good one has more). ``domain_accuracy`` is the domain
head's, ``probe_accuracy`` that of a linear reading of the encodings fitted afterwards: a head that
is fooled does not show that the encoder has forgotten.

Two readings of "worse": "slower" turns at a third of the speed, which no single state shows, as
TPIL supposes; "smaller" also goes round a circle of 0.6 of the size, which every state shows.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import torch as th
from scipy import stats
from torch import nn
from torch.nn import functional as F
from tqdm import tqdm

from silem import paper
from silem.algorithms.gaifo import episode_windows
from silem.algorithms.networks import (
    Discriminator,
    ThirdPersonDiscriminator,
    cross_entropy,
    discriminator_loss,
)
from silem.algorithms.silem import AffineTransform
from silem.util import files, paths

FILE = paths.REPO / "data" / "search" / "reversal.json"
COEFFICIENTS = (0.0, *paper.grid_values("tab4.3_h")["C_g"], 4.0)  # none, the grid's, and more
DEPTHS = (1, 2)  # layers of the shared encoder; the paper's text gives none, ours has one
SEEDS = (0, 1)
WINDOW, HIDDEN, STEPS, BATCH, RATE = 4, (128, 128), 2000, 128, 1e-3
SPEED, AMPLITUDE = 0.6, {"slower": 1.0, "smaller": 0.6}
SHIFT = np.array([0.0, 0.0, 0.0, 0.0, 1.0, -1.0])  # in deviations of the features' noise and swing


def gait(rng: np.random.Generator, speed: float, amplitude: float, n_steps: int) -> np.ndarray:
    """Return one episode's features (T, 6): a circle, its double, and two of noise."""
    phase = rng.uniform(0, 2 * np.pi) + speed * np.arange(n_steps)
    turning = [np.cos(phase), np.sin(phase), np.cos(2 * phase), np.sin(2 * phase)]
    still = 0.5 * rng.standard_normal((n_steps, 2))
    noise = 0.1 * rng.standard_normal((n_steps, 4))
    return np.hstack([amplitude * np.stack(turning, axis=1) + noise, still]).astype(np.float32)


def windows(rng: np.random.Generator, worse: str) -> dict[str, th.Tensor]:
    """Return windows (N, W, 6) of the expert and of the learner's good and bad episodes."""

    def cut(speed: float, amplitude: float, shift: np.ndarray | float) -> th.Tensor:
        episodes = [gait(rng, speed, amplitude, 200) + shift for _ in range(40)]
        return th.from_numpy(
            np.concatenate([episode_windows(e.astype(np.float32), WINDOW) for e in episodes])
        )

    return {
        "expert": cut(SPEED, 1.0, 0.0),
        "good": cut(SPEED, 1.0, SHIFT),
        "bad": cut(SPEED / 3, AMPLITUDE[worse], SHIFT),
    }


def trained(seed: int, worse: str, method: str, coef: float, depth: int) -> dict[str, Any]:
    """Train one discriminator and return what it tells apart on windows it has not seen."""
    th.manual_seed(seed)  # of the layers; the data have their own generator
    rng = np.random.default_rng(seed)
    shown, unseen = windows(rng, worse), windows(rng, worse)
    learner = th.cat([shown["good"], shown["bad"]])
    n_features = learner.shape[-1]
    f: nn.Module = AffineTransform(n_features) if method == "silem" else nn.Identity()
    if method == "tpil":
        d: Any = ThirdPersonDiscriminator(n_features, WINDOW, HIDDEN, coef, depth)
    else:
        d = Discriminator(n_features, WINDOW, HIDDEN)
    disc = th.optim.Adam(d.parameters(), RATE)
    transform = th.optim.Adam(f.parameters(), RATE) if method == "silem" else None
    for _ in range(STEPS):
        e = shown["expert"][th.from_numpy(rng.integers(len(shown["expert"]), size=BATCH))]
        o = learner[th.from_numpy(rng.integers(len(learner), size=BATCH))]
        with th.no_grad():
            tau = f(o)
        loss, _ = discriminator_loss(d, e, tau, entropy_coef=1e-3, gradient_penalty=0.0)
        if method == "tpil":
            loss = loss + cross_entropy(d.domain_logits(e[:, -1]), d.domain_logits(o[:, -1]))
        disc.zero_grad()
        loss.backward()
        disc.step()
        if transform is not None:
            fooled = F.softplus(-d(f(o))).mean()
            transform.zero_grad()
            fooled.backward()
            transform.step()
    with th.no_grad():
        good, bad = (th.sigmoid(d(f(unseen[name]))).numpy() for name in ("good", "bad"))
        told: dict[str, float | None] = {"domain_accuracy": None, "probe_accuracy": None}
        if method == "tpil":
            sides = [unseen["expert"][:, -1], th.cat([unseen["good"], unseen["bad"]])[:, -1]]
            head = [(d.domain_logits(states) > 0).float().mean() for states in sides]
            told["domain_accuracy"] = float(head[0] + 1 - head[1]) / 2
            told["probe_accuracy"] = probe_accuracy(*(d.encoder(s).numpy() for s in sides))
    ranking = stats.mannwhitneyu(good, bad).statistic / (len(good) * len(bad))
    return {
        "worse": worse, "method": method, "coef": coef, "depth": depth, "seed": seed,
        **told, "ranking": float(ranking),
        "reward_good": float(good.mean()), "reward_bad": float(bad.mean()),
    }  # fmt: skip


def probe_accuracy(expert: np.ndarray, learner: np.ndarray) -> float:
    """Return how well least squares tell encodings (N, H) apart, on every other one of them."""
    sides = [np.insert(side, 0, 1.0, axis=1) for side in (expert, learner)]
    rows = np.concatenate([side[::2] / np.sqrt(len(side)) for side in sides])  # sides count alike
    wanted = np.concatenate([np.full(len(side[::2]), sign) / np.sqrt(len(side))
                             for side, sign in zip(sides, (1.0, -1.0), strict=True)])  # fmt: skip
    weights = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    return float(
        ((sides[0][1::2] @ weights > 0).mean() + (sides[1][1::2] @ weights < 0).mean()) / 2
    )


def main() -> None:
    """Train the discriminators that are not in the file and write what each one tells apart."""
    th.set_num_threads(1)
    tpil = [("tpil", coef, depth) for coef, depth in itertools.product(COEFFICIENTS, DEPTHS)]
    methods = [("silem-minus", 0.0, 0), ("silem", 0.0, 0), *tpil]
    cases = list(itertools.product(SEEDS, AMPLITUDE, methods))
    rows = files.read_json(FILE) if FILE.exists() else []
    done = {(r["seed"], r["worse"], (r["method"], r["coef"], r["depth"])) for r in rows}
    for seed, worse, how in tqdm(
        [case for case in cases if case not in done], unit="discriminator"
    ):
        rows.append(trained(seed, worse, *how))
        files.write_json(FILE, rows)


if __name__ == "__main__":
    main()
