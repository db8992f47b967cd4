"""SILEM: Algorithm 1 with its transform T, the affine one or the MLP of Table 1."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
import torch as th
from stable_baselines3.common.torch_layers import create_mlp
from torch import nn
from torch.nn import functional as F

from silem.algorithms.gaifo import GAIfO, descend
from silem.motion.demonstrations import Demonstrations
from silem.util.errors import COUNT, FACTOR, WEIGHT, NumberKind, SilemError, choose

L2_FORMS = ("deviation", "plain")
MLP_HIDDEN_UNITS = 100  # Table 1: "1 hidden layer with 100 units"
STILL = 1e-3  # a feature of the expert's that deviates less tells no gate anything
GATE_SPREAD = 2.0  # two maps then differ by e^2.8 in their weights, one deviation from the mean


class SILEM(GAIfO):
    """Skeletal feature compensation for imitation learning with embodiment mismatch.

    Adds lines 3, 8 and 10 of Algorithm 1 to :class:`GAIfO`: a transform T of the learner's
    windows, which learns to have D take them for the expert's.

    Args:
        policy: As in stable-baselines3 ("MlpPolicy").
        env: As in :class:`GAIfO`, and so are the demonstrations.
        demonstrations: The expert's.
        transform: f of the sequential transform: "affine" is SILEM, "mlp" the ablation of
            Table 1. Without a transform SILEM is :class:`GAIfO`, the paper's SILEM-minus.
        transform_components: K, affine maps between which a gate weighs, state by state; 1, the
            paper's, has no gate.
        n_transform_updates: N_G, transform steps per iteration, one pass over the rollout.
        transform_learning_rate: Adam's rate for T at the first iteration.
        transform_lr_decay: d, factor on the transform's learning rate per iteration.
        transform_l2_scale: w_d, weight of the L2 term on A; 0 switches it off (HalfCheetah, Ant).
        transform_l2_bias: w_b, weight of the L2 term on b; likewise.
        transform_l2_form: "deviation" penalises A - 1, "plain" A itself (see `l2_penalty`).
        **kwargs: Everything :class:`GAIfO` and :class:`PPO` take.

    Raises SilemError as :class:`GAIfO`; an L2 term on, or several components of, another transform
    than the affine one.
    """

    _numbers: ClassVar[dict[str, NumberKind]] = GAIfO._numbers | {
        "transform_components": COUNT, "n_transform_updates": COUNT,
        "transform_learning_rate": WEIGHT, "transform_lr_decay": FACTOR,
        "transform_l2_scale": WEIGHT, "transform_l2_bias": WEIGHT,
    }  # fmt: skip
    _learns: ClassVar[dict[str, tuple[str, str]]] = GAIfO._learns | {
        "transform": ("transform_net", "transform_optimizer")
    }

    def __init__(
        self,
        policy: Any,
        env: Any,
        demonstrations: Demonstrations | Sequence[np.ndarray] | None = None,
        *,
        transform: str = "affine",
        transform_components: int = 1,
        n_transform_updates: int = 5,
        transform_learning_rate: float = 1e-5,
        transform_lr_decay: float = 1.0,
        transform_l2_scale: float = 0.0,
        transform_l2_bias: float = 0.0,
        transform_l2_form: str = "deviation",
        **kwargs: Any,
    ) -> None:
        self.transform = transform
        self.transform_components = transform_components
        self.n_transform_updates = n_transform_updates
        self.transform_learning_rate = transform_learning_rate
        self.transform_lr_decay = transform_lr_decay
        self.transform_l2_scale = transform_l2_scale
        self.transform_l2_bias = transform_l2_bias
        self.transform_l2_form = transform_l2_form
        super().__init__(policy, env, demonstrations, **kwargs)

    @classmethod
    def load(cls, *args: Any, **kwargs: Any) -> Any:
        """Load a model as `PPO.load`; how often T steps is kept where its rate decays by that."""
        model = super().load(*args, **kwargs)
        if "n_transform_updates" in kwargs and model.transform_lr_decay < 1:
            raise SilemError("n_transform_updates cannot change: T's steps count its rate's decay")
        return model

    def update_transform(self, tau_c: th.Tensor) -> dict[str, float]:
        """Make N_G steps of line 10 on windows (N, W, F); D's weights stay.

        Returns the mean of its loss -log D(T(o)), without the L2 term, and the learning rate.
        """
        adam = self.transform_optimizer.state[next(self.transform_net.parameters())]
        iteration = int(adam.get("step", 0)) // self.n_transform_updates  # 0 for the first
        rate = self.transform_learning_rate * self.transform_lr_decay**iteration
        self.transform_optimizer.param_groups[0]["lr"] = rate
        losses = []
        for rows in self._passes(len(tau_c), self.n_transform_updates):
            logits = self.discriminator(self._transformed(tau_c[rows]))
            loss = F.softplus(-logits).mean()  # -log sigmoid(logit)
            losses.append(loss.item())
            if self.transform_l2_scale or self.transform_l2_bias:
                weights = self.transform_l2_scale, self.transform_l2_bias
                assert isinstance(self.transform_net, AffineTransform)
                loss = loss + l2_penalty(self.transform_net, *weights, self.transform_l2_form)
            descend(self.transform_optimizer, loss)
        if isinstance(self.transform_net, AffineEnsemble):
            self.transform_net.weigh(tau_c[..., : self.demonstrations.n_features])
        return {"transform_loss": float(np.mean(losses)), "transform_learning_rate": rate}

    def _transformed(self, windows: th.Tensor) -> th.Tensor:
        """Return T(o) of windows (N, W, F); the absorbing state has no features to transform."""
        if not self._absorbing:
            return self.transform_net(windows)
        features, mark = windows[..., :-1], windows[..., -1:]
        return th.cat([self.transform_net(features) * (1.0 - mark), mark], dim=-1)

    def _check_settings(self) -> None:
        super()._check_settings()
        choose("transform", self.transform, TRANSFORMS)
        choose("transform_l2_form", self.transform_l2_form, L2_FORMS)
        if (self.transform_l2_scale or self.transform_l2_bias) and self.transform != "affine":
            raise SilemError(f"the L2 term is the affine transform's; {self.transform!r} has none")
        if self.transform_components > 1 and self.transform != "affine":
            raise SilemError(f"only affine maps have components, not {self.transform!r}")

    def _setup_model(self) -> None:
        super()._setup_model()
        size, count = self.demonstrations.n_features, self.transform_components
        if count == 1:
            transform = TRANSFORMS[self.transform](size)
        else:
            states = th.from_numpy(np.concatenate(self.demonstrations.features))
            transform = AffineEnsemble(count, states)
        self.transform_net, rate = transform.to(self.device), self.transform_learning_rate
        self.transform_optimizer = th.optim.Adam(transform.parameters(), lr=rate)

    def _report(self, stats: dict[str, float], judged: np.ndarray) -> None:
        super()._report(stats, judged)
        if isinstance(self.transform_net, AffineTransform):
            mean = self.transform_net.mean()
            for name, values in (("scale", mean["A"]), ("offset", mean["b"])):
                for i, entry in enumerate(values.tolist()):
                    self.logger.record(f"transform/{name}_{i}", entry, exclude="stdout")


# ---------------------------------------------------------------- transforms


class AffineTransform(nn.Module):
    """f(g(s)) = A g(s) + b on F features, with diagonal A; starts as the identity."""

    def __init__(self, n_features: int) -> None:
        super().__init__()
        self.scale = nn.Parameter(th.ones(n_features))
        self.offset = nn.Parameter(th.zeros(n_features))

    def forward(self, features: th.Tensor) -> th.Tensor:
        """Transform features (..., F) state by state."""
        return features * self.scale + self.offset

    def mean(self) -> dict[str, np.ndarray]:
        """Return A's diagonal and b, (F,) each; of several maps the mean that `weigh` noted."""
        found = {"A": self._one(self.scale), "b": self._one(self.offset)}
        return {name: values.detach().cpu().numpy() for name, values in found.items()}

    def _one(self, values: th.Tensor) -> th.Tensor:
        return values


class AffineEnsemble(AffineTransform):
    """K affine maps: f(g) = sum over k of w_k(g) (A_k g + b_k), w = softmax of a linear gate on g.

    All maps start as the identity, and so does f, whatever the gate says. What lets them part is
    the gate's first weights, random and large enough to choose: over the expert's states (N, F) a
    logit has deviation `GATE_SPREAD` around 0, so each map counts in other states, and follows
    another gradient. Maps that count alike everywhere would stay alike: of a gradient Adam follows
    the sign. The gate learns once they differ; between equal maps its choice changes nothing.
    """

    shares: th.Tensor

    def __init__(self, n_components: int, states: th.Tensor) -> None:
        deviation, n_features = states.std(dim=0), states.shape[1]
        super().__init__(n_features)
        for name in ("scale", "offset"):
            start = getattr(self, name).detach()
            setattr(self, name, nn.Parameter(start.repeat(n_components, 1)))
        self.gate = nn.Linear(n_features, n_components)
        moves = deviation > STILL
        spread = GATE_SPREAD / moves.sum().sqrt() / deviation
        with th.no_grad():
            self.gate.weight.normal_().mul_(spread.where(moves, 0.0))
            self.gate.bias.copy_(-self.gate.weight @ states.mean(dim=0))
        self.shares = nn.Buffer(th.full((n_components,), 1.0 / n_components))

    def forward(self, features: th.Tensor) -> th.Tensor:
        """Transform features (..., F) state by state."""
        weights = self.weights(features)
        return features * (weights @ self.scale) + weights @ self.offset

    def weights(self, features: th.Tensor) -> th.Tensor:
        """Return w (..., K) in states (..., F)."""
        return th.softmax(self.gate(features), dim=-1)

    def weigh(self, features: th.Tensor) -> None:
        """Note the gate's mean weights over states (..., F)."""
        with th.no_grad():
            self.shares.copy_(self.weights(features).flatten(0, -2).mean(0))

    def _one(self, values: th.Tensor) -> th.Tensor:
        return self.shares @ values


TRANSFORMS: dict[str, Callable[[int], nn.Module]] = {
    "affine": AffineTransform,
    "mlp": lambda size: nn.Sequential(*create_mlp(size, size, [MLP_HIDDEN_UNITS], nn.Tanh)),
}
"""f of the sequential transform by name: one function, applied to every state of a window."""


def l2_penalty(
    transform: AffineTransform, scale_coef: float, offset_coef: float, form: str = "deviation"
) -> th.Tensor:
    """Return the supplement's L2 term on the affine transform, ``w_d |A|^2 + w_b |b|^2``.

    The supplement names the coefficients and not the form. "deviation" measures A from one: the
    identity, which says that the two bodies are alike, is what a transform should fall back to
    where D asks for nothing. The "plain" norm pulls A to 0, hence every feature to a constant that
    tells nothing. Both are means over the features, of an ensemble over all its maps' too, so that
    a coefficient weighs the same beside the loss of line 10 whatever F and K are.
    """
    rest = 1.0 if form == "deviation" else 0.0
    scale_term = (transform.scale - rest).square().mean()
    return scale_coef * scale_term + offset_coef * transform.offset.square().mean()
