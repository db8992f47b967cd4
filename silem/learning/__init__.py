"""PPO as stable-baselines3's class, with the tanh MLP's arithmetic written out in NumPy."""

from silem.learning.ppo import PPO

__all__ = ["PPO"]
