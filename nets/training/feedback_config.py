"""How often a network in training is given an earlier answer of its own."""

from nets.unrolling_config import Share
from warp_caustics.strict import Strict


class FeedbackConfig(Strict):
    """Of networks with ``network.feedback``; see ``feedback.py``."""

    share: Share = 0.5
    """Of the rounds of fresh samples that are given an answer and its echo; the others are given a flat plate."""
    twice_share: Share = 0.25
    """Of those: their answer is one that was itself given an answer."""
