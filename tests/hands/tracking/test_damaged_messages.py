"""Messages with random damage: each is a frame or a fault that is counted, and the good ones after it come through."""

import random

import numpy as np
import pytest

from airtact.errors import LONGEST_SENTENCE
from airtact.hands.tracking.messages import to_json, to_osc
from airtact.hands.tracking.stream import RESTART, HandStream
from damage import damaged, seeds
from references.motions import still

CLOUD = np.random.default_rng(0).normal(scale=0.03, size=(20, 3))


@pytest.mark.parametrize("batch", seeds(200, 1000))
@pytest.mark.parametrize("kind", ["json", "osc"])
def test_a_damaged_message_is_used_or_counted(batch, kind):
    for seed in batch:
        check_seed(seed, kind)


def check_seed(seed: int, kind: str) -> None:
    draw, stream = random.Random(seed), HandStream(silence=1e6)
    frame = draw.choice([still(5), still(5, landmarks=None), still(5, cloud=CLOUD)])
    write, feed = (to_json, stream.feed_json) if kind == "json" else (to_osc, stream.feed_osc)
    fault = feed(damaged(write(frame), draw))
    if fault is not None:
        assert str(fault).isprintable()
        assert len(str(fault)) <= LONGEST_SENTENCE
    for index in range(6, 6 + 2 * RESTART):  # the damaged one may be far ahead of those that follow
        stream.feed(still(index))
    newest = stream.latest("left")
    assert newest is not None
    assert newest.sequence == 5 + 2 * RESTART
