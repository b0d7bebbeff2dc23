"""What a model leaves is described as it is, kept in the battery file, and older files go on without it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import EffectEntry, Wander
from uavbatt.errors import BadInput
from uavbatt.fitting import prior, wander
from uavbatt.fitting.wander import Misfit, likelihood

GENERIC = battery_file.read_battery("lipo-generic")
WANDER = Wander(
    soc=[0.0, 1.0], voltage_sd_V=[0.04, 0.02], voltage_time_s=90.0, voltage_noise_V=0.008, rest_sd_V=0.01,
    temperature_sd_K=0.3, temperature_time_s=600.0, temperature_noise_K=0.05,
)  # fmt: skip


def wandering(sd: float, tau_s: float, noise: float, records: int, rows: int) -> Misfit:
    """Records of a process that is known, twice as large below a charge of one half."""
    random = np.random.default_rng(5)
    time_s = np.repeat(5.0 * np.arange(rows)[:, None], records, axis=1)
    soc = np.repeat(np.linspace(1.0, 0.0, rows)[:, None], records, axis=1)
    z = random.standard_normal((rows, records))
    kept = np.exp(-5.0 / tau_s)
    for k in range(1, rows):
        z[k] = kept * z[k - 1] + np.sqrt(1.0 - kept**2) * z[k]
    value = sd * np.where(soc < 0.5, 2.0, 1.0) * z + noise * random.standard_normal(z.shape)
    return Misfit(value, time_s, soc, np.zeros_like(z), np.ones(z.shape, dtype=bool))


def test_the_likelihood_is_largest_near_what_the_records_were_made_with() -> None:
    misfit = wandering(0.03, 100.0, 0.008, records=12, rows=240)
    right = np.log(np.where(wander.SOC < 0.5, 0.06, 0.03))
    lower = [
        (right, np.log(100.0), np.log(0.008)),
        (right + np.log(1.5), np.log(100.0), np.log(0.008)),
        (right, np.log(300.0), np.log(0.008)),
        (right, np.log(100.0), np.log(0.016)),
        (np.full_like(right, np.log(0.045)), np.log(100.0), np.log(0.008)),
    ]
    sd, tau, noise = (np.array(column) for column in zip(*lower, strict=True))
    values = likelihood(misfit, sd, tau, noise)
    assert np.argmin(values) == 0
    assert np.all(values[1:] > values[0] + 10.0)


def test_one_record_alone_agrees_with_the_covariance_written_out() -> None:
    misfit = wandering(0.03, 100.0, 0.008, records=1, rows=60)
    log_sd = np.log(np.full(wander.SOC.size, 0.03))
    time_s, value = misfit.time_s[:, 0], misfit.value[:, 0]
    covariance = 0.03**2 * np.exp(-np.abs(time_s[:, None] - time_s) / 100.0) + 0.008**2 * np.eye(60)
    expected = 0.5 * value @ np.linalg.solve(covariance, value) + 0.5 * np.linalg.slogdet(covariance)[1]
    found = likelihood(misfit, log_sd[None], np.log([100.0]), np.log([0.008]))
    assert found[0] == pytest.approx(expected, rel=1e-9)


def test_a_wander_is_part_of_the_hash_and_a_file_without_one_has_the_hash_it_always_had(tmp_path: Path) -> None:
    plain = battery_file.read_battery(battery_file.write_battery(GENERIC, tmp_path / "a.battery.toml"))
    assert plain.discrepancy.wander is None
    assert "wander" not in (tmp_path / "a.battery.toml").read_text()
    told = msgspec.structs.replace(GENERIC, discrepancy=msgspec.structs.replace(GENERIC.discrepancy, wander=WANDER))
    again = battery_file.read_battery(battery_file.write_battery(told, tmp_path / "b.battery.toml"))
    assert again.discrepancy.wander == WANDER
    assert battery_file.content_hash(again) != battery_file.content_hash(plain)


def test_knots_that_do_not_fit_each_other_are_named(tmp_path: Path) -> None:
    crooked = msgspec.structs.replace(WANDER, soc=[1.0, 0.0])
    bad = msgspec.structs.replace(GENERIC, discrepancy=msgspec.structs.replace(GENERIC.discrepancy, wander=crooked))
    with pytest.raises(BadInput, match="wander"):
        battery_file.write_battery(bad, tmp_path / "bad.battery.toml")
    assert not list(tmp_path.iterdir())


def test_what_would_be_refused_is_not_written(tmp_path: Path) -> None:
    beyond = EffectEntry(name="temperature_lag", parameters={"sensor_lag_s": 1000.0})
    with pytest.raises(BadInput, match="sensor_lag_s"):
        battery_file.write_battery(msgspec.structs.replace(GENERIC, effects=[beyond]), tmp_path / "bad.battery.toml")
    assert not list(tmp_path.iterdir())


def test_a_fit_stays_within_what_a_battery_file_may_hold() -> None:
    slots = prior.cell_slots((*prior.BASE_EFFECTS, "charge_transfer"))
    for u in (-40.0, 40.0):
        for slot, value in zip(slots, prior.values(slots, np.full(len(slots), u)), strict=True):
            assert slot.low <= value <= slot.high
