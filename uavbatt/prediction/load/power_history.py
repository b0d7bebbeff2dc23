"""The powers that a flight has asked so far, in pieces of seconds: what it may ask again.

A motor that runs at intervals (glider, racer, lift of a VTOL, hops from field to field) draws several times its mean
power for some seconds, and the flight ends in such seconds. A normal distribution around the mean does not show this;
the flight itself does. So the power to come is that of this flight flown again, each scenario from another place in it,
rather from one that looks like now: a motor that has just started runs on, and one that has stood still for a minute
will soon start.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array

MEAN_TAU_S, GUST_TAU_S = 60.0, 5.0  # time constants of the averages
LOWEST_POWER_W = 1.0  # least load: a forecast divides by it
SHORTEST_PIECE_S = 5.0  # the mean over 5 s that ends a flight
MOST_PIECES = 1024
LONGEST_ROW_S = 30.0  # the power in a longer gap is not known
# Used before a flight has shown its own: manoeuvres of 15 % move a minute's mean by a tenth. It counts as two minutes.
MINUTE_S, PRIOR_MINUTE_SD, PRIOR_MINUTES = 60.0, 0.095, 2.0
# A place looks like now if the mean powers before it are like the last ones, over each of these times [s].
LIKE_S, LIKE_SD = (5.0, 20.0, 60.0), 0.5  # the sd is of ln of the power: the swings of a hover count little
LIKE_FLOOR = 0.1  # of the mean power, added to all: smaller powers are alike
LEAST_ALIKE = 1e-9  # below it no place looks like now
ANY_SHARE = 0.2  # of the scenarios begins anywhere: the flight may change


class PowerHistory(NamedTuple):
    """PowerHistory holds the mean powers [W] of pieces of `piece_s` [s], the oldest first, and the open piece."""

    piece_s: float = SHORTEST_PIECE_S
    open_J: float = 0.0
    open_s: float = 0.0
    pieces_W: tuple[float, ...] = ()

    @property
    def is_possible(self) -> bool:
        """Return True if a flight can have left this: a saved file may hold anything."""
        is_known = all(math.isfinite(number) for number in (self.open_J, *self.pieces_W))
        is_open = SHORTEST_PIECE_S <= self.piece_s < math.inf and 0.0 <= self.open_s < self.piece_s
        return is_known and is_open and len(self.pieces_W) < MOST_PIECES

    @property
    def length_s(self) -> float:
        """Return the time of all closed pieces [s]."""
        return len(self.pieces_W) * self.piece_s

    def after(self, power_W: float, dt_s: float) -> PowerHistory:
        """Return the same with `dt_s` [s] more at `power_W` [W]."""
        now, left_s = self, min(max(dt_s, 0.0), LONGEST_ROW_S)
        while now.open_s + left_s >= now.piece_s:
            part_s = now.piece_s - now.open_s
            now = now._closed((now.open_J + part_s * power_W) / now.piece_s)
            left_s -= part_s
        return PowerHistory(now.piece_s, now.open_J + left_s * power_W, now.open_s + left_s, now.pieces_W)

    @property
    def mean_W(self) -> float:
        """Return the mean power of all closed pieces [W]; there must be one."""
        return float(np.mean(self.pieces_W))

    def last(self, length_s: float) -> PowerHistory:
        """Return the same without what is older than `length_s` [s] before the open piece."""
        return self._replace(pieces_W=self.pieces_W[-max(round(length_s / self.piece_s), 1) :])

    def _closed(self, piece_W: float) -> PowerHistory:
        """Return the same with one more piece; where there are too many, two become one."""
        pieces_W, piece_s = (*self.pieces_W, piece_W), self.piece_s
        if len(pieces_W) == MOST_PIECES:
            pieces_W = tuple(np.mean(np.reshape(pieces_W, (-1, 2)), axis=1).tolist())
            piece_s *= 2.0
        return PowerHistory(piece_s, pieces_W=pieces_W)

    def blocks_W(self, block_s: float, most: int) -> Array:
        """Return the mean powers [W] of the last blocks of `block_s` [s], at most `most`; they end at `length_s`."""
        count, (at_s, drawn_J) = min(most, int(self.length_s / block_s)), self._energy_until()
        edges_s = self.length_s - block_s * np.arange(count, -1, -1)
        return np.asarray(np.diff(np.interp(edges_s, at_s, drawn_J)) / block_s)

    def again(self, edges_s: Array, count: int) -> Array:
        """Return the power between `edges_s` [steps + 1] [s] of `count` flights like this one, [steps, count].

        It is relative to the mean, 1 where the flight has shown nothing yet.
        """
        if not sum(self.pieces_W) > 0.0:
            return np.ones((edges_s.size - 1, count))
        at_s, drawn_J = self._energy_until(times=2 + int(edges_s[-1] / self.length_s))
        once = slice(len(self.pieces_W) + 1)
        begins_s = np.interp(_ranks(count), self._likely_until(at_s[once], drawn_J[once]), at_s[once])[:, None]
        passed_J = np.interp(edges_s + begins_s, at_s, drawn_J)  # by flight: ascending times are looked up fast
        return np.asarray(np.diff(passed_J) / (np.mean(self.pieces_W) * np.diff(edges_s))).T

    def _likely_until(self, at_s: Array, drawn_J: Array) -> Array:
        """Return the share 0..1 of the scenarios that begin until the end of each piece, by what looks like now.

        at_s, drawn_J : the ends of the pieces [s] and the energy until each [J], of one flight (`_energy_until`).
        What followed on the last minute is not known yet: it counts as the others on average.
        """
        middles_s, now_s = 0.5 * (at_s[1:] + at_s[:-1]), self.length_s + self.open_s
        known_s, known_J = np.append(at_s, now_s), np.append(drawn_J, drawn_J[-1] + self.open_J)
        floor_W, apart = LIKE_FLOOR * drawn_J[-1] / self.length_s, np.zeros(middles_s.size)
        for window_s in LIKE_S:
            ends_s = np.append(middles_s, now_s)
            begins_s = np.maximum(ends_s - window_s, 0.0)
            drawn = np.interp(ends_s, known_s, known_J) - np.interp(begins_s, known_s, known_J)
            level = np.log(np.maximum(drawn / (ends_s - begins_s), 0.0) + floor_W)  # below 0 it charges
            apart += np.square((level[:-1] - level[-1]) / LIKE_SD)
        alike, is_known = np.exp(-0.5 * apart), middles_s < self.length_s - max(LIKE_S)
        alike[~is_known] = np.mean(alike[is_known]) if is_known.any() else 1.0
        share = (1.0 - ANY_SHARE) * alike / max(float(np.sum(alike)), LEAST_ALIKE) + ANY_SHARE / alike.size
        return np.concatenate([[0.0], np.cumsum(share / share.sum())])

    def _energy_until(self, times: int = 1) -> tuple[Array, Array]:
        """Return the ends of the pieces [s], from 0 on, and the energy [J] drawn until each, of so many flights."""
        drawn_J: Array = self.piece_s * np.concatenate([[0.0], np.cumsum(np.tile(self.pieces_W, times))])
        return self.piece_s * np.arange(float(drawn_J.size)), drawn_J

    @property
    def minute_sd(self) -> float:
        """Return the relative sd of a minute's mean power, by all but the last, which may be another load."""
        pieces = max(round(MINUTE_S / self.piece_s), 1)
        before_W = np.array(self.pieces_W[:-pieces])
        if before_W.size < pieces or not before_W.mean() > 0.0:
            return PRIOR_MINUTE_SD
        means = np.convolve(before_W, np.full(pieces, 1.0 / pieces), mode="valid") / before_W.mean()
        minutes = before_W.size / pieces
        squares = PRIOR_MINUTES * PRIOR_MINUTE_SD**2 + minutes * float(np.mean((means - 1.0) ** 2))
        return math.sqrt(squares / (PRIOR_MINUTES + minutes))


class RecentLoad(NamedTuple):
    """RecentLoad remembers the power [W] in exponentially weighted means; it is a value, replaced by `after`."""

    time_s: float = math.nan
    mean_W: float = math.nan
    gust_W: float = math.nan
    history: PowerHistory = PowerHistory()

    def after(self, time_s: float, power_W: float) -> RecentLoad:
        """Return the memory with one more row; rows must come in order of time."""
        if not math.isfinite(self.time_s):
            return RecentLoad(time_s, power_W, power_W)
        dt_s = max(time_s - self.time_s, 0.0)
        mean_W = power_W + (self.mean_W - power_W) * math.exp(-dt_s / MEAN_TAU_S)
        gust_W = power_W + (self.gust_W - power_W) * math.exp(-dt_s / GUST_TAU_S)
        return RecentLoad(time_s, mean_W, gust_W, self.history.after(power_W, dt_s))


@cache
def _ranks(count: int) -> Array:
    """Return ranks 0..1 [count] of the places from which the flight is flown again, in random order."""
    return np.random.default_rng(count).permutation((np.arange(count) + 0.5) / count)
