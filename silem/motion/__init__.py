"""Skeletal features g, and where the human demonstrator's come from.

`features` computes g of any humanoid. `clips` reads motion capture, `demonstrator` poses it and
publishes the motion, `retargeting` puts it on another body; `kinematics` is what both need of
sequences of poses. `demonstrations` is what imitators learn from, whoever demonstrates.
"""
