"""What is believed of a pack after a landing: its rested voltage is the best evidence there is of its charge."""

from __future__ import annotations

import pytest
from cases import first_quick
from factories import generic_estimator
from scoring.other_pack import LIHV, LIPO, Make, Pack, flown, rested
from scoring.scenarios import STATED


@pytest.mark.parametrize("make", [LIPO, LIHV], ids=lambda make: make.name)
@pytest.mark.parametrize(("left_s", "pause_s"), first_quick(1, [(30, 20), (30, 120), (120, 40)]))
def test_a_short_hop_after_a_landing_is_not_said_too_long(make: Make, left_s: int, pause_s: int) -> None:
    """An emptied LiHV pack was believed to hold 23 % of its charge (6 % in truth), with a fifth more of capacity."""
    whole_s = len(flown(Pack(make=make), 0.0))
    pack = Pack(make=make)
    rows = rested(pack, 20, 0.0)
    rows += flown(pack, 20.0, whole_s - left_s, rows[-1].consumed_Ah)
    rows += rested(pack, pause_s, rows[-1].time_s + 1.0, rows[-1].consumed_Ah)
    landed_soc, begin_s = pack.soc, rows[-1].time_s + 1.0
    rows += flown(pack, begin_s, drawn_Ah=rows[-1].consumed_Ah, seed=4)
    said = list(generic_estimator(STATED, period_s=5.0).run(rows))
    at_rest = [e for e, _ in said if e.time_s < begin_s][-1]
    assert abs(at_rest.soc - landed_soc) < max(2.0 * at_rest.soc_sd, 0.08)
    assert at_rest.capacity_scale < 1.12
    hop = [r for _, r in said if r.time_s >= begin_s + 6.0]
    assert max(r.remaining_lo_s - (rows[-1].time_s - r.time_s) for r in hop) < 25.0
