"""Skeletal features g, and where the human demonstrator's come from.

`features` computes g of any humanoid. `clips` reads motion capture, `demonstrator` poses it and
publishes the motion, `retargeting` puts it on another body; `kinematics` is what both need of
sequences of poses. `demonstrations` is what imitators learn from, whoever demonstrates.
"""


def retargeted(demonstrations: str, body: str) -> str:
    """Return the name of demonstrations retargeted to a body: "cmu_08_01_on_Atlas"."""
    return f"{demonstrations}_on_{body}"
