"""A charge that no record of a fit reached: the error of the curve there must be met by a pack that sinks to it."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from uavbatt.battery.battery_file import BatteryFile, Certificate
from uavbatt.battery.model import GRID_STEP, SOC_GRID, Array
from uavbatt.battery.spreads import SEEN_V, spread_of
from uavbatt.battery.state_space import drift_variance
from uavbatt.fitting import assemble, prior
from uavbatt.fitting.generic import generic_lipo

SLOTS = prior.cell_slots()
X = np.array([slot.prior for slot in SLOTS])
USUAL_V = {f"ocv_{soc:g}": 0.012 for soc in prior.OCV_SOC}


def gained_V(errors_V: dict[str, float], from_soc: float, to_soc: float) -> float:
    """Return the sd that the discrepancy of a pack gains while its charge falls, beyond what a sound curve lets it."""

    def variance_V2(stated_V: dict[str, float]) -> float:
        generic = generic_lipo()
        table = msgspec.structs.replace(generic.parameters, standard_error=stated_V)
        file: BatteryFile = msgspec.structs.replace(generic, parameters=table, certificate=Certificate(status="fitted"))
        drift_sd_V: Array = spread_of(file).ocv_drift_sd_V
        passed = (to_soc < SOC_GRID) & (from_soc >= SOC_GRID)
        return float(np.sum(drift_variance(drift_sd_V[passed], GRID_STEP)))

    return float(np.sqrt(variance_V2(errors_V) - variance_V2(USUAL_V)))


@pytest.mark.parametrize("soc", [0.05, 0.075, 0.1])
def test_a_pack_that_sinks_there_has_gained_the_error_that_is_stated(soc: float) -> None:
    _, errors_V = assemble.with_unseen_ocv(SLOTS, X, USUAL_V, 0.25)
    stated_V = float(np.interp(soc, prior.OCV_SOC, [errors_V[name] for name in USUAL_V]))
    assert stated_V > SEEN_V
    assert 0.8 * stated_V < gained_V(errors_V, 0.3, soc) < 1.25 * stated_V


def test_the_curve_falls_sooner_and_is_doubted_below_the_charge_that_flights_reached_alone() -> None:
    x, errors_V = assemble.with_unseen_ocv(SLOTS, X, USUAL_V, 0.2)
    (ocv_V, _), (usual_V, _) = prior.knots(SLOTS, x), prior.knots(SLOTS, X)
    unseen = prior.OCV_SOC < 0.2
    assert (ocv_V[unseen] < usual_V[unseen]).all() and (np.diff(ocv_V) > 0.0).all()
    assert ocv_V[~unseen].tolist() == usual_V[~unseen].tolist()
    assert [errors_V[name] > USUAL_V[name] for name in USUAL_V] == unseen.tolist()
    assert errors_V["ocv_0.05"] > 10.0 * errors_V["ocv_0.15"]
    assert x[len(prior.OCV_SOC) :].tolist() == X[len(prior.OCV_SOC) :].tolist()
