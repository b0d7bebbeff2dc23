"""The detector of a pack that was changed on the ground; it is a value that is replaced at each row.

A pack is changed on the ground, usually while the telemetry is silent. After a silence, the rested voltage of the old
pack has two bounds. Upper bound: the pack rested all the time, so the open-circuit voltage at its last charge. Lower
bound: the load continued to the end of the silence, and the overpotentials are still present. If the rested voltage is
outside these bounds for several rows, the pack is another one. After a silence of minutes the old pack would have
settled, so that both bounds are close to its predicted voltage, also with an idle load on the ground. A charge counter
of the autopilot that has fallen also shows another pack, unless the flight evidently continued. Without a silence,
four observations show another pack: a fall of the rested voltage (at rest it only rises), once the voltage rises
slowly, a sudden rise or a voltage far too high, and seconds without a pack while disarmed. After these the same pack
may come back, but nothing says so. Under avionics that draw more than a pack at rest gives, a leap of the voltage
beside a current that stays shows it. A pack that is charged in the aircraft, in a dock, counts as another one, too: its
voltage rises long after it has settled, or a current flows into it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.battery import model
from uavbatt.battery import state_space as b
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief, X
from uavbatt.estimation.innovation import Innovation
from uavbatt.limits import FLYING_C_RATE, GROUNDED_C_RATE
from uavbatt.records import NAN, Sample

# Rows that must show another pack, and how long: a current that comes 0.3 s late shows one at each take-off at 10 Hz.
RESTED_C_RATE, SWAP_ROWS, SWAP_LASTS_S = 0.15, 3, 1.9
FAR_CELL_V, ODD_CELL_V, FALLEN_CELL_V = 0.12, 0.05, 0.05
# A pack that has rested for SLOWLY_AFTER_S rises by at most 1 mV a second; a worn pack in the cold by 3 mV.
LEAPT_CELL_V, LEAPT_WITHIN_S, SLOWLY_AFTER_S, QUIET_MEMORY = 0.035, 3.0, 15.0, 0.7
# Five minutes after a flight no pack rises by 0.03 V a cell any more, unless it is empty. A minute is no glitch.
CHARGED_AFTER_S, CHARGED_CELL_V, CHARGING_C_RATE, CHARGING_S = 300.0, 0.03, 0.05, 60.0
SILENCE_S, SILENT_ROWS, SETTLED_S = 5.0, 4.0, 120.0
# Below it there is no pack: the autopilot has another supply. No cell rests at 2.7 V, and USB is 2.6 V for each of two.
NO_PACK_CELL_V, NO_PACK_AT_REST_CELL_V = 2.0, 2.7
OUT_S = 3.0  # without a pack for so long on the ground: it was taken out
ROW_MEMORY, LONGEST_ROW_S = 0.9, 30.0
SHOWN_S = 60.0  # time in which rows show the pack
SAME_SHARE = 0.2  # a load on the ground is the same within such a share, or within what a pack at rest may give
COUNTER_SLACK_AH, RESTARTED_S = 0.02, 60.0  # changing a pack and taking off takes longer than a minute


class Silence(NamedTuple):
    """Silence holds the data that tell the old pack from another one after a silence that ended at `over_s` [s].

    lowest_V, highest_V : which the old pack can show at rest, per cell [V]; counted_Ah : the autopilot's counter before
    the silence [Ah]; may_fly_on : it is short and began under a load that flies, and the first row after it is as the
    old pack would be.
    """

    over_s: float
    lowest_V: float
    highest_V: float
    counted_Ah: float
    may_fly_on: bool

    def is_another_rested(self, cell_V: float) -> bool:
        """Return True if a cell at rest shows a voltage [V] that the old pack cannot show."""
        return not self.lowest_V <= cell_V <= self.highest_V

    def has_restarted(self, consumed_Ah: float) -> bool:
        """Return True if the counter [Ah] has fallen: the autopilot was restarted."""
        return consumed_Ah < self.counted_Ah - COUNTER_SLACK_AH


class Quiet(NamedTuple):
    """Quiet holds means of the last rows on the ground under the same load, which is small or none.

    cell_V : voltage of a cell [V]; current_A : [A]; since_s : time of the first of them [s]. NaN without such rows.
    """

    cell_V: float = NAN
    current_A: float = NAN
    since_s: float = NAN

    def after(self, time_s: float, cell_V: float, current_A: float, capacity_Ah: float) -> Quiet:
        """Return the means after one more row; they begin anew if its load is another."""
        if not self.is_same_load(cell_V, current_A, capacity_Ah):
            return Quiet(cell_V, current_A, time_s)
        mean_V = cell_V + (self.cell_V - cell_V) * QUIET_MEMORY
        return Quiet(mean_V, current_A + (self.current_A - current_A) * QUIET_MEMORY, self.since_s)

    def is_same_load(self, cell_V: float, current_A: float, capacity_Ah: float) -> bool:
        """Return True if a current [A] is that of these rows, or the power is: behind a converter the current falls."""
        of_power_A = current_A * cell_V / self.cell_V
        off_A = min(abs(current_A - self.current_A), abs(of_power_A - self.current_A))
        return off_A < max(SAME_SHARE * self.current_A, RESTED_C_RATE * capacity_Ah)

    def shows_another(self, time_s: float, cell_V: float, current_A: float, row_s: float, capacity_Ah: float) -> bool:
        """Return True if a row is of another pack than these rows; row_s : time since the last row [s].

        Under the same load a pack falls slowly, and after some seconds it rises slowly, too. Under more it falls.
        """
        is_slow = time_s - self.since_s > SLOWLY_AFTER_S and row_s <= LEAPT_WITHIN_S
        has_leapt = is_slow and cell_V > self.cell_V + LEAPT_CELL_V
        if self.is_same_load(cell_V, current_A, capacity_Ah):
            return has_leapt or cell_V < self.cell_V - FALLEN_CELL_V
        return has_leapt and current_A > self.current_A


class SwapWatch(NamedTuple):
    """SwapWatch holds the last row with a pack, and how many rows in turn have shown another pack.

    seen_s, current_A, consumed_Ah, belief : time [s], current [A], counter [Ah] and belief of that row.
    """

    seen_s: float = NAN
    current_A: float = 0.0
    belief: Belief | None = None
    row_s: float = NAN  # the usual time between two rows
    consumed_Ah: float = NAN
    silence: Silence | None = None  # kept until the pack is loaded
    rows: int = 0
    other_since_s: float = NAN  # time of the first of these rows
    quiet: Quiet = Quiet()  # of the believed pack
    settled_V: float = NAN  # of a cell, the lowest one since it has settled
    charging_s: float = 0.0  # time for which a current has flown into the pack since the last flight [s]
    out_since_s: float = NAN  # since when the input has shown no pack
    is_out: bool = False  # the pack was taken out
    is_another: bool = False  # enough rows have shown another pack

    def after(
        self, sample: Sample, row: Innovation, belief: Belief | None, pack: Pack, read_V: float = NAN
    ) -> SwapWatch:
        """Return the watch after one more sample, with `row`, the sample against the model, and the belief after it.

        read_V : the voltage before cleaning [V], which shows an input without a pack
        """
        cells, capacity_Ah = float(pack.installation.cells), float(pack.installation.present_capacity_Ah)
        time_s, cell_V, current_A = sample.time_s, sample.voltage_V / cells, sample.current_A
        is_at_rest = abs(current_A) < RESTED_C_RATE * capacity_Ah
        is_parked = is_at_rest and (sample.armed is False or self.current_A < FLYING_C_RATE * capacity_Ah)
        least_V = NO_PACK_AT_REST_CELL_V if is_parked else NO_PACK_CELL_V
        if belief is None or not (cell_V > least_V and math.isfinite(current_A)):
            return self._without_pack(sample.time_s, read_V / cells, is_parked)
        gap_s = time_s - self.seen_s
        row_s, silence = self.row_s, self.silence
        if math.isfinite(row_s) and gap_s > max(SILENCE_S, SILENT_ROWS * row_s):
            silence = self._silence(sample, row, pack)
        elif gap_s > 0.0:
            row_s = gap_s + (row_s - gap_s) * ROW_MEMORY if math.isfinite(row_s) else min(gap_s, LONGEST_ROW_S)
        consumed_Ah = sample.consumed_Ah if math.isfinite(sample.consumed_Ah) else self.consumed_Ah
        charging_s = self.charging_s if current_A < FLYING_C_RATE * capacity_Ah else 0.0
        if current_A < -CHARGING_C_RATE * capacity_Ah and sample.armed is not True and gap_s > 0.0:
            charging_s += min(gap_s, LONGEST_ROW_S)
        now = SwapWatch(time_s, current_A, belief, row_s, consumed_Ah, charging_s=charging_s)
        if self.is_out:
            return self._other(now, silence)._replace(is_out=True)
        if is_at_rest:
            return self._at_rest(now, silence, sample, row.innovation_V / cells, cell_V, capacity_Ah)
        if silence is None:
            most_C = GROUNDED_C_RATE if sample.armed is False else FLYING_C_RATE
            may_idle = sample.armed is not True and 0.0 < current_A < most_C * capacity_Ah
            return self._while_quiet(now, None, cell_V, capacity_Ah, is_another=False) if may_idle else now
        if now._shows_another(silence, sample, pack):
            return self._other(now, silence)
        return now._replace(silence=silence) if _is_on_ground(silence, sample, pack) else now  # else it flies on

    def _at_rest(
        self,
        now: SwapWatch,
        silence: Silence | None,
        sample: Sample,
        above_V: float,
        cell_V: float,
        capacity_Ah: float,
    ) -> SwapWatch:
        """Return the watch `now` with what a row at rest shows.

        above_V : how far its voltage is above the model's [V a cell]; cell_V : its voltage [V a cell].
        """
        is_same = self.quiet.is_same_load(cell_V, now.current_A, capacity_Ah)
        is_far = now.seen_s - self.quiet.since_s > SLOWLY_AFTER_S and above_V > FAR_CELL_V
        is_charged = cell_V > self.settled_V + CHARGED_CELL_V
        other = (is_same and (is_far or is_charged)) or now.charging_s >= CHARGING_S
        if silence is not None:
            other = other or silence.is_another_rested(cell_V) or silence.has_restarted(sample.consumed_Ah)
        return self._while_quiet(now, silence, cell_V, capacity_Ah, is_another=other)

    def _while_quiet(
        self, now: SwapWatch, silence: Silence | None, cell_V: float, capacity_Ah: float, *, is_another: bool
    ) -> SwapWatch:
        """Return the watch `now` with what a row on the ground shows, with so many volts a cell.

        is_another : something else than the rows before it shows another pack.
        """
        row_s, before = now.seen_s - self.seen_s, self.quiet
        if is_another or before.shows_another(now.seen_s, cell_V, now.current_A, row_s, capacity_Ah):
            return self._other(now._replace(quiet=before, settled_V=self.settled_V), silence)
        quiet = before.after(now.seen_s, cell_V, now.current_A, capacity_Ah)
        is_settled = now.seen_s - quiet.since_s > CHARGED_AFTER_S
        settled_V = min(quiet.cell_V, self.settled_V) if math.isfinite(self.settled_V) else quiet.cell_V
        return now._replace(silence=silence, quiet=quiet, settled_V=settled_V if is_settled else NAN)

    def _without_pack(self, time_s: float, cell_V: float, is_parked: bool) -> SwapWatch:
        """Return the watch after a row that shows no pack, with so many volts a cell.

        is_parked : without a current, and disarmed or not flying before: the pack was taken out; else a broken wire.
        """
        if not (is_parked and cell_V < NO_PACK_AT_REST_CELL_V):
            return self._replace(out_since_s=NAN)
        since_s = self.out_since_s if math.isfinite(self.out_since_s) else time_s
        return self._replace(out_since_s=since_s, is_out=self.is_out or time_s - since_s >= OUT_S)

    def _other(self, now: SwapWatch, silence: Silence | None) -> SwapWatch:
        """Return the watch `now` with one row more that shows another pack."""
        rows, since_s = self.rows + 1, self.other_since_s if self.rows else now.seen_s
        is_another = rows >= SWAP_ROWS and now.seen_s - since_s >= SWAP_LASTS_S
        return now._replace(silence=silence, rows=rows, other_since_s=since_s, is_another=is_another)

    def _shows_another(self, silence: Silence, sample: Sample, pack: Pack) -> bool:
        """Return True if a row that is not at rest shows another pack than the one before the silence."""
        if silence.has_restarted(sample.consumed_Ah) and not silence.may_fly_on:
            return True
        if not _is_on_ground(silence, sample, pack):
            return False
        cells = float(pack.installation.cells)
        return silence.is_another_rested((sample.voltage_V + self._drop_V(pack, sample.current_A)) / cells)

    def _drop_V(self, pack: Pack, current_A: float) -> float:
        """Return the instantaneous voltage drop of the pack under a current [V], by the last belief."""
        assert self.belief is not None
        x = self.belief.mean
        return float(b.voltage(pack, x, 0.0) - b.voltage(pack, x, current_A))

    def _silence(self, sample: Sample, row: Innovation, pack: Pack) -> Silence:
        """Return the data about the old pack at the end of a silence, which ends with this row."""
        cells, capacity_Ah = float(pack.installation.cells), float(pack.installation.present_capacity_Ah)
        gap_s, expected_V = sample.time_s - self.seen_s, row.expected_V
        if self.belief is not None and abs(sample.current_A) >= RESTED_C_RATE * capacity_Ah:
            expected_V += self._drop_V(pack, sample.current_A)
        was_flying = self.current_A >= FLYING_C_RATE * capacity_Ah and gap_s <= RESTARTED_S
        may_fly_on = was_flying and abs(row.innovation_V) <= ODD_CELL_V * cells
        return Silence(sample.time_s, *self._at_rest_V(gap_s, expected_V / cells, pack), self.consumed_Ah, may_fly_on)

    def _at_rest_V(self, gap_s: float, predicted_V: float, pack: Pack) -> tuple[float, float]:
        """Return the lowest and the highest voltage of a cell of the old pack at rest after `gap_s` [s] of silence."""
        if gap_s > SETTLED_S or self.belief is None:
            return predicted_V - ODD_CELL_V, predicted_V + ODD_CELL_V
        mean, sd = self.belief.mean, math.sqrt(self.belief.covariance[X.SOC, X.SOC])
        drawn = max(self.current_A, 0.0) * gap_s / 3600.0 / float(pack.installation.present_capacity_Ah)
        lag_V = max(float(mean[X.POLARISATION] + mean[X.DIFFUSION]), 0.0)
        low_V = float(model.open_circuit_voltage(pack.cell, mean[X.SOC] - drawn - sd)) - lag_V
        high_V = float(model.open_circuit_voltage(pack.cell, min(mean[X.SOC] + sd, 1.0)))
        return low_V - ODD_CELL_V, high_V + ODD_CELL_V


def _is_on_ground(silence: Silence, sample: Sample, pack: Pack) -> bool:
    """Return True if a row soon after a silence has less load than a flight, and is not armed."""
    capacity_Ah = float(pack.installation.present_capacity_Ah)
    is_idle = abs(sample.current_A) < FLYING_C_RATE * capacity_Ah and sample.armed is not True
    return is_idle and sample.time_s - silence.over_s <= SHOWN_S
