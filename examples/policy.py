"""A policy of your own, compared with the server's and then served by.

swings-abr demo/stream --generate 3 --policy sweep,examples/policy.py:Cautious
swings-serve demo/stream --policy examples/policy.py:Cautious
"""

from server.study.policies import Rule, Situation


class Cautious(Rule):
    """One more layer for every 1.5 seconds that the client holds."""

    def choose_layers(self, situation: Situation) -> int:
        return int(situation.lead_s / 1.5)
