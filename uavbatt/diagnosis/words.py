"""Words for a crew chief: what each effect means, what to do next, and which reading tells it from its rivals."""

from __future__ import annotations

GUESS = "the battery file's voltage below a charge of {:g} is a guess: what records show there is called no effect"
CHECK = {
    "current_gain": "compare the current sensor with a clamp meter in hover, or the consumed mAh with the charger's",
    "current_offset": "read the current with the battery connected and nothing switched on: it should be zero",
    "unmetered_load": "look for a payload wired past the current sensor; switch it off for one flight",
    "capacity_fade": "charge the empty pack and read the mAh that the charger put in",
    "weak_cell": "read the voltages of the single cells near the end of a flight",
    "resistance_growth": "read the pack's internal resistance with a charger at room temperature",
    "harness_resistance": "measure the voltage at the pack's own plug in hover and compare it with the log",
    "voltage_gain": "compare the logged voltage with a multimeter at a full and at an empty pack",
    "voltage_offset": "compare the logged voltage with a multimeter at one charge, motors off",
    "sag_compensation": "read BATT_OPTIONS (bit 6), or compare the logged voltage with a multimeter in hover",
    "temperature_offset": "compare the logged temperature with a thermometer after the pack has lain for an hour",
    "temperature_lag": "warm the sensor with a finger and look how fast it follows",
    "airflow_cooling": "measure the pack's skin by hand right after landing; look at how the pack is ventilated",
    "rate_capacity": "discharge the pack slowly (C/2) once and compare the charge with a flight's",
    "initial_charge": "let the pack rest after charging and read its voltage before arming",
    "current_delay": "log voltage and current at 10 Hz through a step of throttle",
    "charge_transfer": "read the pack's internal resistance with a charger that measures at a small current",
    "hysteresis": "rest the pack ten minutes half-way, once after a charge and once after a discharge",
    "polarisation": "log ten minutes of rest after landing: how fast the voltage comes back tells",
    "slow_diffusion": "log an hour of rest after landing: how far the voltage comes back tells",
    "temperature_resistance": "fly the same pack once cold and once warm",
    "self_heating": "let the log run for half an hour after landing: how the pack cools tells",
}
MEANING = {
    "current_gain": "the current sensor reads too much or too little in proportion",
    "current_offset": "the current sensor adds a constant",
    "unmetered_load": "something draws power that the current sensor does not see",
    "capacity_fade": "the pack has lost capacity",
    "weak_cell": "one cell holds less than the others",
    "resistance_growth": "the pack's inner resistance has grown",
    "harness_resistance": "leads or plugs drop voltage between pack and sensor",
    "voltage_gain": "the voltage sensor reads too much or too little in proportion",
    "voltage_offset": "the voltage sensor adds a constant",
    "sag_compensation": "the reported voltage is corrected for the load, or the file's resistance is too large",
    "temperature_offset": "the temperature sensor adds a constant",
    "temperature_lag": "the temperature sensor follows the pack differently than the file says",
    "airflow_cooling": "the pack is cooled by more air in flight than on the bench",
    "rate_capacity": "less charge comes out at a high load",
    "initial_charge": "flights do not start with a full pack",
    "current_delay": "current and voltage are not reported for the same instant",
    "charge_transfer": "the cells react sluggishly: the voltage drops under any load, hardly more under a large one",
    "hysteresis": "the pack's voltage depends on whether it was charged or discharged last",
    "polarisation": "the voltage gives way over seconds to a minute more than the file says",
    "slow_diffusion": "the voltage gives way over minutes more than the file says",
    "temperature_resistance": "resistance changes with temperature otherwise than the file says",
    "self_heating": "the pack warms otherwise than the file says",
}

QUANTITY = {
    "gain_I": "current read, as a share of the true one",
    "offset_A": "added by the current sensor",
    "unmetered_W": "power that the sensor does not see",
    "fade": "share of the capacity that is lost",
    "deficit": "share of its capacity that the weak cell lacks",
    "growth": "growth of the resistance, as a share",
    "harness_ohm": "resistance of the leads",
    "gain_V": "voltage read, as a share of the true one",
    "offset_V": "added by the voltage sensor",
    "compensation_ohm": "resistance by which the reported voltage is corrected",
    "offset_K": "added by the temperature sensor",
    "sensor_lag_s": "time by which the sensor is late",
    "airflow_gain_h": "growth of cooling per C of load",
    "rate_gain_h": "share of charge lost per C of load",
    "start_soc_shift": "charge at the start, less that of a full pack",
    "delay_s": "time by which the current is late",
    "hysteresis_V": "drop of a cell after charging",
    "transfer_V": "drop of a cell under a large load",
    "polarisation_ratio": "size of the polarisation, of the resistance",
    "diffusion_ratio": "size of the diffusion, of the resistance",
    "activation_K": "growth of the resistance in the cold",
    "diffusion_activation_K": "growth of the diffusion in the cold",
}

SHARES = {"fade", "deficit", "growth"}  # shown in percent


def separating(members: tuple[str, ...], outside: str | None) -> str:
    """Say which readings tell the members apart; for a single member, which reading confirms it."""
    if len(members) > 1:
        return "; ".join(f"{name}: {CHECK[name]}" for name in members)
    against = f" (against {outside})" if outside else ""
    return f"{CHECK[members[0]]}{against}"
