"""Skeletal features g, and where the human demonstrator's come from.

`features` computes g of any humanoid. `mocap`, `fetch`, `poses` and `demonstrator` turn CMU's
motion capture into a demonstrator's motion, `clips` publishes it, `retarget` puts it on another
body.
"""
