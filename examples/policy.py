"""Compares a policy of your own with the server's, in virtual time, on a link that breaks down.

python examples/policy.py demo/stream
"""

import sys
from pathlib import Path

from server.abr.link.link import Link, LinkStep
from server.abr.session import SessionConfig
from server.abr.sweep import Sweep
from server.study.looped import open_media
from server.study.policies.inorder import InOrder
from server.study.policies.situation import Situation
from server.study.simulate.qoe import score
from server.study.simulate.simulator import play_out, simulate


class Cautious:
    """One more layer for every 1.5 seconds that the client holds."""

    horizon = 1

    def choose_layers(self, situation: Situation) -> int:
        return max(1, min(situation.most_layers, int(situation.lead_s / 1.5)))


media = open_media(Path(sys.argv[1]), length_s=30.0)
good, bad = 1.5 * media.need_bps, 0.2 * media.need_bps
link = Link([LinkStep(6.0, good, 0.02), LinkStep(3.0, bad, 0.04)])
config = SessionConfig()
for name, policy in (("cautious", InOrder(Cautious())), ("the server's", Sweep())):
    result = simulate(media, policy, link, config)
    shown, clock = play_out(media, result, config, 0, media.num_frames)
    psnr_db, best_db = [frame.psnr_db for frame in shown], media.best_db(range(media.num_frames))
    started_s = clock.started_s or 0.0
    qoe = score(psnr_db, best_db, media.fps, started_s, clock.stalled_s, clock.stalls)
    layers = sum(frame.layers for frame in shown) / len(shown)
    print(
        f"{name}: {layers:.2f} layers, {qoe.psnr_db:.2f} dB, {qoe.stalls} stalls, "
        f"{qoe.stalled_s:.2f} s; QoE {qoe.quality_db:.2f}"
    )
