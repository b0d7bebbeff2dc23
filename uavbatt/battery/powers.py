"""The power of a multirotor over airspeed and climb: the law behind `[powers]` in a vehicle file.

    P / P_hover = 1 + a (k(v) - 1) + b (v / 10)³ + c₊ climb + d₊ f climb - (c₋ + d₋ f) sink + take-off + landing
    k⁴ + k² (v / v_h)² = 1       induced velocity of a rotor in level flight over that in hover (momentum theory)
    f = v² / (v² + 8²)           the share of fast flight, in which climbing costs more and sinking saves more

v is the airspeed and v_h the induced velocity in hover [m/s]. The law is linear in the learned shares, so that least
squares with a prior finds them; with few data they stay near theory and other aircraft. The level of a flight (its
payload and pack) scales all of it except the drag b: a payload must be lifted, but it does not change the drag.

An aircraft that turns and accelerates to V passes through a hover, and within T gains the kinetic energy m V² / 2 with
the efficiency of its rotors in hover, η = m g v_h / P_hover:

    P_turn = (P_hover + P(V)) / 2 + P_hover V² / (2 g v_h T)

Reference: Leishman, Principles of Helicopter Aerodynamics, 2nd ed. (2006), eq. 2.14 (hover) and 2.141 (forward
flight); the share of fast flight is ours, measured on 40 flights of a Matrice 100.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from uavbatt.battery.model import Array

DRAG_AT_MS = 10.0  # where `drag` is a share of the hover power: v/10 in the law
FAST_MS = 8.0  # airspeed at which the share f of fast flight is a half
MOST_BEYOND = 4.0
TURN_S = 5.0  # time of a turn up to the new speed: 4 to 6 s for a simulated quadrotor
GRAVITY_MS2 = 9.81
TERMS = ("induced", "drag", "climb", "descent", "fast_climb", "fast_descent", "take_off", "landing")

Share = Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)]
Spread = Annotated[float, msgspec.Meta(ge=0.0, le=2.0)]


class Powers(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Powers holds the power law of an aircraft; all but `hover_W` and `induced_ms` are shares of the hover power.

    `climb` and `descent` are per m/s; the spreads are relative standard deviations between flights (`level_sd`: payload
    and pack; `fast_sd`: wind and attitude in fast flight or climb) and from row to row within a leg (`row_sd`).
    `fastest_ms` is the airspeed [m/s] up to which the law was learned; None if nobody has recorded it.
    """

    hover_W: Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
    induced_ms: Annotated[float, msgspec.Meta(ge=1.0, le=30.0)] = 5.0
    induced: Share = 0.6
    drag: Share = 0.15
    climb: Share = 0.09
    descent: Share = 0.03
    fast_climb: Share = 0.06
    fast_descent: Share = 0.08
    take_off: Share = 0.0
    landing: Share = 0.0
    level_sd: Spread = 0.08
    fast_sd: Spread = 0.10
    row_sd: Spread = 0.10
    fastest_ms: Annotated[float, msgspec.Meta(ge=1.0, le=300.0)] | None = None
    flights: Annotated[int, msgspec.Meta(ge=0)] = 0
    seconds: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0

    @property
    def shares(self) -> Array:
        """Return the learned shares [8] in the order of `TERMS`."""
        return np.array([getattr(self, term) for term in TERMS])


# An unknown aircraft: momentum theory with 60 % of the hover power induced, and the slopes of the measured multirotors.
# `hover_W` is set from the power flown so far.
UNKNOWN = Powers(hover_W=1.0, level_sd=0.12, fast_sd=0.15, fastest_ms=15.0)
PRIOR_SD = np.array([0.15, 0.15, 0.03, 0.03, 0.05, 0.05, 0.08, 0.08])  # spread of the shares between aircraft


def of_hover(hover_W: float) -> Powers:
    """Return the powers of an unknown aircraft that asks `hover_W` [W] in hover."""
    return msgspec.structs.replace(UNKNOWN, hover_W=hover_W)


def induced_ratio(airspeed_ms: ArrayLike, induced_ms: float) -> Array:
    """Return k: induced velocity in level flight at this airspeed [m/s] over that in hover; 1 in hover."""
    half = 0.5 * (np.asarray(airspeed_ms, float) / induced_ms) ** 2
    return np.sqrt(np.sqrt(half**2 + 1.0) - half)


def terms(
    airspeed_ms: ArrayLike, climb_ms: ArrayLike, taking_off: ArrayLike, landing: ArrayLike, induced_ms: float
) -> Array:
    """Return the columns [..., 8] that the shares multiply, in the order of `TERMS`."""
    air, up = np.asarray(airspeed_ms, float), np.asarray(climb_ms, float)
    fast = air**2 / (air**2 + FAST_MS**2)
    climb, sink = np.maximum(up, 0.0), np.maximum(-up, 0.0)
    columns = (
        induced_ratio(air, induced_ms) - 1.0,
        (air / DRAG_AT_MS) ** 3,
        climb,
        -sink,
        fast * climb,
        -fast * sink,
        np.asarray(taking_off, float),
        np.asarray(landing, float),
    )
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def power(powers: Powers, columns: Array, level: float = 1.0) -> Array:
    """Return the power [W] for columns of `terms` at a level; never less than a fifth of the hover's."""
    lifted, dragged = _shares(powers, columns)
    return np.asarray(powers.hover_W * np.maximum(level * lifted + dragged, 0.2 * level))


def beyond_learned(powers: Powers, airspeed_ms: Array) -> Array:
    """Return by how much the power of drag at an airspeed [m/s] exceeds what was learned: (v / fastest)³ - 1, 0 below.

    The law is extrapolated there, and its spread `fast_sd` grows with it; MOST_BEYOND is the largest value.
    """
    if powers.fastest_ms is None:
        return np.zeros_like(airspeed_ms)
    return np.asarray(np.clip((airspeed_ms / powers.fastest_ms) ** 3 - 1.0, 0.0, MOST_BEYOND))


def level_of(powers: Powers, columns: Array, power_W: float) -> float:
    """Return the level at which these columns of `terms` ask `power_W` [W]."""
    lifted, dragged = _shares(powers, columns)
    return (power_W / powers.hover_W - float(dragged)) / max(float(lifted), 0.2)


def _shares(powers: Powers, columns: Array) -> tuple[Array, Array]:
    """Return the share of the hover power that the level scales, and the share of drag, which it does not scale.

    For an unknown aircraft the level is its hover power, which scales all terms.
    """
    dragged = columns[..., TERMS.index("drag")] * (powers.drag if powers.flights else 0.0)
    return np.asarray(1.0 + columns @ powers.shares - dragged), np.asarray(dragged)


def turning_power(powers: Powers, flown_W: Array, gained_ms: ArrayLike, level: float = 1.0) -> Array:
    """Return the mean power [W] over TURN_S in which an aircraft turns and speeds up from rest.

    flown_W : the power at its new speed [W]; gained_ms : that speed over ground [m/s]
    """
    hover_W = powers.hover_W * level
    gained = np.square(gained_ms) / (2.0 * GRAVITY_MS2 * powers.induced_ms * TURN_S)
    return np.asarray(0.5 * (hover_W + flown_W) + hover_W * gained)
