"""The engine against its peers: a filter step, a forecast, a replay, and how the cost grows with the flight.

Each figure is the median over repeats that take turns, so that what else the machine does hits both sides.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from uavbatt import compiled
from uavbatt.battery import battery_file
from uavbatt.battery.capacity_prior import Capacities, capacities, known_capacity
from uavbatt.battery.scaling import Pack, pack_of
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.battery.state_space import SIZE, Belief, X
from uavbatt.engine import PLAIN, Engine
from uavbatt.estimation.filter import SocFilter
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import steps
from uavbatt.prediction import batch
from uavbatt.prediction.batch import Question
from uavbatt.prediction.forecaster import Forecaster, ForecastSettings
from uavbatt.prediction.load.scenarios import ConstantLoad
from uavbatt.prediction.simulation.sampling import Normals
from uavbatt.prediction.simulation.time_to_end import time_to_end
from uavbatt.records import Flight, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight

Row = tuple[str, str, str, str]  # what, ours, the peer's, ratio
HAS_TWIN = compiled.is_available()
PROGPY = Path(__file__).with_name("progpy_forecast.py")
LOAD_SPREAD = 0.15  # of the power that the forecasts are asked about


def pack() -> Pack:
    """Return a 4S 5 Ah pack of the packaged file."""
    return pack_of(battery_file.read_battery("lipo-generic"), 4, 5.0, 13.2, 14.0)


def flight(minutes: float, rate_Hz: float = 10.0) -> list[Sample]:
    """Return a flight of so many minutes, before the end of its pack, which is as large as it takes."""
    capacity_Ah = 5.0 * minutes / 20.0
    made = pack_of(battery_file.read_battery("lipo-generic"), 4, capacity_Ah, 13.2, 14.0)
    if minutes <= 30.0:
        return simulate_flight(made, SimulatedFlight(36.0 * capacity_Ah, rate_Hz=rate_Hz, seed=3))[
            : int(60.0 * minutes * rate_Hz)
        ]
    short = flight(20.0, rate_Hz)
    times = int(minutes / 20.0)
    drop_V = (short[int(60 * rate_Hz)].voltage_V - short[-1].voltage_V) / len(short)
    return [  # the load again and again, the voltage sinking as slowly as the pack is large
        replace(s, time_s=s.time_s + 1200.0 * n, voltage_V=s.voltage_V + drop_V * (k - (k + n * len(short)) / times))
        for n in range(times)
        for k, s in enumerate(short)
    ]


def in_turn(works: list[Callable[[], Any]], repeats: int) -> list[float]:
    """Return the median time [s] of each work, taken in turn; the first round only warms up."""
    spent: list[list[float]] = [[] for _ in works]
    for n in range(repeats + 1):
        for work, times in zip(works, spent, strict=True):
            begin = time.perf_counter()
            work()
            if n:
                times.append(time.perf_counter() - begin)
    return [median(times) for times in spent]


def filterpy_step() -> Callable[[], None]:
    """Return one predict and update of filterpy's extended filter of our size, whose model costs nothing."""
    from filterpy.kalman import ExtendedKalmanFilter

    kalman = ExtendedKalmanFilter(dim_x=SIZE, dim_z=2)
    kalman.Q, kalman.R = np.eye(SIZE) * 1e-6, np.eye(2)
    observation, measured = np.eye(2, SIZE), np.zeros(2)

    def step() -> None:
        kalman.predict()
        kalman.update(measured, lambda x: observation, lambda x: x[:2])

    return step


def filter_rows() -> Iterator[Row]:
    """Yield the time of a row [us]: filterpy alone, our filter on filterpy, the twin."""
    peer = filterpy_step()
    for name, rows in (("10 Hz", flight(20.0)), ("a row every 2 s", flight(100.0, 0.5))):

        def alone(count: int = len(rows)) -> None:
            for _ in range(count):
                peer()

        def one_by_one(samples: list[Sample] = rows) -> None:
            made = bank()
            for sample in samples:
                made.step(sample)

        def in_windows(samples: list[Sample] = rows) -> None:
            bank().run(samples)

        works: list[Callable[[], Any]] = [alone, one_by_one, in_windows]
        if HAS_TWIN:
            works += [twin(rows, capacities(pack())), twin(rows, known_capacity(pack()))]
        took = [s / len(rows) * 1e6 for s in in_turn(works, 7)]
        yield (
            f"filter, {name}, row by row",
            f"{took[1]:.1f} µs",
            f"filterpy's EKF alone {took[0]:.1f} µs",
            _ratio(took[0], took[1]),
        )
        yield f"filter, {name}, in windows", f"{took[2]:.1f} µs", f"{took[0]:.1f} µs", _ratio(took[0], took[2])
        if HAS_TWIN:
            yield (
                f"filter, {name}, twin over arrays, all members",
                f"{took[3]:.2f} µs",
                f"{took[0]:.1f} µs",
                _ratio(took[0], took[3]),
            )
            yield "  the same for one member", f"{took[4]:.2f} µs", f"{took[0]:.1f} µs", _ratio(took[0], took[4])
            yield (
                "  all members against our filter on filterpy",
                f"{took[3]:.2f} µs",
                f"{took[1]:.1f} µs",
                _ratio(took[1], took[3]),
            )


def bank() -> SocFilter:
    """Return the filter as it flies: a member for each capacity."""
    return SocFilter(pack(), capacities=capacities(pack()))


def twin(samples: list[Sample], members: Capacities) -> Callable[[], Any]:
    """Return a call of the twin alone: columns in, as a reader gives them, columns out."""
    from uavbatt.compiled.filter import begun, run
    from uavbatt.compiled.jit import as_numbers
    from uavbatt.estimation.recursion import start

    state, _ = start(pack(), samples[0], float("nan"), members)
    numbers, given = as_numbers(pack()), begun(state, samples[1:])
    return lambda: run(numbers, *given)


def question(minutes: float = 20.0) -> tuple[Question, Belief, Forecaster]:
    """Return a forecast whose end is `minutes` away, and the belief and forecaster that it is made from."""
    forecaster = Forecaster(
        pack(),
        ForecastSettings(ConstantLoad(pack().installation.capacity_Ah * 14.8 * 0.9 * 60.0 / minutes, LOAD_SPREAD)),
    )
    mean = np.zeros(SIZE)
    mean[X.SOC], mean[X.CORE], mean[X.SENSOR] = 0.95, 25.0, 25.0
    sd = np.zeros(SIZE)
    sd[X.SOC], sd[X.CORE], sd[X.SENSOR] = 0.01, 1.0, 1.0
    sd[X.POLARISATION], sd[X.DIFFUSION], sd[X.BIAS], sd[X.REACTION] = 0.003, 0.003, 0.005, 0.005
    sd[X.LOG_RESISTANCE], sd[X.LOG_CAPACITY] = 0.05, 0.03
    belief = Belief.gaussian(mean, np.diag(sd**2), 20.0)
    found = forecaster.question(belief, 0.0)
    assert found is not None
    return found, belief, forecaster


def forecast_rows(progpy_s: float) -> Iterator[Row]:
    """Yield the time of a forecast [ms] whose end is 10 minutes away, and of one whose end is 20 minutes away."""
    for minutes in (10.0, 20.0):
        yield from _one_forecast(minutes, progpy_s if minutes == 20.0 else float("nan"))


def _one_forecast(minutes: float, progpy_s: float) -> Iterator[Row]:
    asked, belief, forecaster = question(minutes)
    works: list[Callable[[], Any]] = [lambda: forecaster.forecast(belief, 0.0)]
    works.append(lambda: batch.answers([asked] * batch.SIDE_BY_SIDE))
    if HAS_TWIN:
        answers = compiled.engine().answers
        works.append(lambda: answers([asked]))
    took = in_turn(works, 15)
    took[1] /= batch.SIDE_BY_SIDE
    peer = f"ProgPy, unscented, {progpy_s:.2f} s" if np.isfinite(progpy_s) else ""
    names = (f"forecast, end in {minutes:.0f} min, 128 draws, numpy", "  sixteen side by side, each", "  compiled")
    for name, ours in zip(names, took, strict=False):
        yield name, f"{1e3 * ours:.2f} ms", peer, _ratio(progpy_s, ours)


def accuracy_rows(progpy_words: str) -> Iterator[Row]:
    """Yield median and 90 % interval of that forecast against 4096 draws in 1 s steps, and ProgPy's against its own."""
    asked, belief, forecaster = question()
    found, truth_s = forecaster.forecast(belief, 0.0), np.quantile(reference_ends_s(belief, asked), (0.05, 0.5, 0.95))
    assert found is not None
    said_s = (found.lo_s, found.median_s, found.hi_s)
    told = "5, 50, 95 %: " + ", ".join(f"{s:.0f}" for s in said_s) + " s of " + ", ".join(f"{s:.0f}" for s in truth_s)
    yield "  accuracy against the same model, drawn 4096 times", f"{told} s", progpy_words, ""


def reference_ends_s(belief: Belief, asked: Question, draws: int = 4096) -> Any:
    """Return the ends [s] of a flight of the bench's load, drawn anew and simulated in fine steps."""
    random, steps = np.random.default_rng(7), int(asked.horizon_s)
    x = random.multivariate_normal(belief.mean, belief.covariance, draws).T
    x[X.SOC] = np.clip(x[X.SOC], 0.0, 1.02)
    mean_W = float(np.median(asked.flying.power_W))
    power_W = np.broadcast_to(mean_W * np.exp(LOAD_SPREAD * random.standard_normal(draws)), (steps, draws))
    bias = random.standard_normal((steps, draws))
    found = time_to_end(asked.flying._replace(x=x, power_W=power_W, dt_s=np.ones(steps)), Normals(bias, bias))
    return np.minimum(found.end_s, asked.horizon_s)


def progpy_s(python: str) -> tuple[float, str]:
    """Return ProgPy's time [s] for an unscented prediction of 20 minutes, and what it found.

    NaN and its error message where it does not run.
    """
    done = subprocess.run([python, str(PROGPY)], capture_output=True, text=True, check=False)
    if done.returncode:
        return float("nan"), done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "it failed"
    seconds, words = done.stdout.strip().split(" ", 1)
    return float(seconds), words


def replay_rows() -> Iterator[Row]:
    """Yield a 20-minute flight at 10 Hz in memory: its estimates alone over arrays; all rows, a forecast every 5 s."""
    if HAS_TWIN:
        (alone_s,) = in_turn([twin(flight(20.0), capacities(pack()))], 15)
        told = f"{1.0 / alone_s:.0f} flights/s a core"
        yield "estimates of 20 min at 10 Hz, arrays", f"{1e3 * alone_s:.1f} ms", told, ""
    whole = Flight("simulated", "csv", tuple(flight(20.0)))
    engines = [PLAIN, *([compiled.engine()] if HAS_TWIN else [])]
    took = in_turn([partial(replayed, whole, engine) for engine in engines], 5)
    names = ("replay of 20 min at 10 Hz, numpy", "  with numba")
    for name, ours in zip(names, took, strict=False):
        yield name, f"{ours:.2f} s", f"{1.0 / ours:.1f} flights/s a core", ""


def replayed(flight: Flight, engine: Engine) -> int:
    """Return the number of rows of a replay."""
    options = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    estimator = Estimator(battery_file.read_battery("lipo-generic"), options, engine=engine)
    return sum(1 for _ in steps(flight, estimator))


def growth_rows() -> Iterator[Row]:
    """Yield the cost of flights 1, 10 and 100 times as long."""
    base = 0.0
    for minutes in (2.0, 20.0, 200.0):
        whole = Flight("simulated", "csv", tuple(flight(minutes)))
        begin = time.perf_counter()
        estimator = Estimator(
            battery_file.read_battery("lipo-generic"),
            PackOptions(cells=4, capacity_Ah=5.0 * minutes / 20.0, cutoff_V=13.2),
        )
        rows = sum(1 for _ in steps(whole, estimator))
        took = time.perf_counter() - begin
        base = base or took
        yield (
            f"replay of {minutes:.0f} min at 10 Hz",
            f"{took:.2f} s",
            f"{1e6 * took / rows:.0f} µs a row",
            f"{took / base:.1f}",
        )


def _ratio(theirs: float, ours: float) -> str:
    return f"{theirs / ours:.3g}" if np.isfinite(theirs) else ""


def run_cli(arguments: list[str], plain: bool) -> float:
    """Return the wall time [s] of a whole `uavbatt` command in a new process: in numpy, or compiled, however short."""
    code = "from uavbatt.log_replay import run; run.MANY_ROWS = 0; from uavbatt.cli import main; main()"
    environment = {**os.environ, **({"XDG_CACHE_HOME": f"{os.devnull}/none"} if plain else {})}
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", code, *arguments], check=True, capture_output=True, env=environment)
    return time.perf_counter() - begin
