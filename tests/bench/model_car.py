"""A car of 1:10 from its logs to laps: how closely and how fast it drives (docs/tuning.md).

A single-track car of 3.74 kg, other than the models of this package, is driven by pure pursuit over
three surfaces; `egp collect` and `egp train` make a library of these logs. Laps of 38 m with bends
of 1.1 m over friction 1.0, 0.6 and 0.35 then have noisy measurements: first with a speed that is
planned for the true friction, with two sets of costs, and then with one that is planned for what is
known of the road, with lengths of the belief of this car and of a full-size one.

    python tests/bench/model_car.py          # three minutes
"""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path as File
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from egp_service import Controller, Path, RoadBelief, VehicleParameters
from egp_service.control.toml_text import dumps
from egp_service.simulation.closed_loop import Run, drive
from egp_service.simulation.course import build_path
from egp_service.simulation.reference import new_belief
from egp_service.simulation.scenario import Measurement, Scenario, Speed, Track, Zone

Array = NDArray[np.float64]

CAR = VehicleParameters(
    mass=3.74,
    yaw_inertia=0.047,
    l_f=0.159,
    l_r=0.171,
    width=0.27,
    a_min=-9.0,
    a_max=6.0,
    power=60.0,
    a_slew=120.0,
    peak_slip=0.2,
    steering_angle=0.42,
    steering_rate=3.2,
    steering_slew=64.0,
    lateral_grip=0.95,
    braking_grip=0.6,
    driving_grip=0.6,
)
SURFACES = {"carpet": 1.0, "tile": 0.6, "dusty": 0.35}
ZONES = ((0.0, 1.0), (12.0, 0.6), (26.0, 0.35))  # m, friction
CORNERS = ((0, 0), (12, 0), (12, 6), (7.5, 6), (7.5, 3), (4.5, 3), (4.5, 6), (0, 6))
RADII = (1.5, 1.2, 1.5, 1.1, 1.1, 1.1, 1.1, 1.2)
HALF_WIDTH = 0.9
DT = 0.02
UNITS = ("s", "m/s", "m/s", "rad/s", "rad", "m/s2")
COLUMNS = dict(zip(("time", "v_x", "v_y", "omega", "delta", "a_x"), UNITS, strict=True))
NOISE = Measurement(position=0.005, v_x=0.02, psi=0.005, v_y=0.015, omega=0.03, delta=0.002)
FULL_SIZE: dict[str, object] = {
    "longitudinal": 10.0,
    "lateral": 60.0,
    "v_x": 2.0,
    "input": [0.05, 2.0],
    "rate": [0.05, 10.0],
}
COSTS: dict[str, dict[str, object]] = {"of a full-size car": FULL_SIZE, "defaults": {}}
SEEDS, LAPS = range(5), 4


class Car:
    """A car with four driven wheels (`egp_service.simulation.plant.Simulator`)."""

    state: Array

    def reset(self, x: Array) -> None:
        """Put the car into the state `x` (7,)."""
        self.state = x.copy()

    def step(self, u: Array, dt: float, friction: float) -> None:
        """Drive `dt` seconds with force (N) and steering rate (rad/s), in steps of 1 ms."""
        for _ in range(round(dt / 1e-3)):
            middle = self.state + 0.5e-3 * self._rate(self.state, u, friction)
            self.state = self.state + 1e-3 * self._rate(middle, u, friction)

    @staticmethod
    def _rate(x: Array, u: Array, mu: float) -> Array:
        _, _, v_x, psi, v_y, omega, delta = x
        m, l_f, l_r = CAR.mass, CAR.l_f, CAR.l_r
        a = float(np.clip(u[0] / m, CAR.a_min, min(CAR.a_max, CAR.power / max(v_x, 0.5))))
        v = max(v_x, 0.3)
        slips = (
            delta - np.arctan2(v_y + l_f * omega, v),
            -np.arctan2(v_y - l_r * omega, v),
        )
        moved = m * a * 0.03 / (l_f + l_r)  # load, by the height of the centre of mass
        loads = (m * 9.81 * l_r / (l_f + l_r) - moved, m * 9.81 * l_f / (l_f + l_r) + moved)
        shares = (0.5, 0.5) if a > 0.0 else (0.6, 0.4)
        ahead, across = [], []
        for slip, load, share in zip(slips, loads, shares, strict=True):
            most = mu * load
            f_x = float(np.clip(share * m * a, -0.98 * most, 0.98 * most))
            curve = np.sin(1.4 * np.arctan(9.0 * slip))
            ahead.append(f_x)
            across.append(most * curve * np.sqrt(1.0 - (f_x / most) ** 2))
        sin, cos = np.sin(delta), np.cos(delta)
        front_x = ahead[0] * cos - across[0] * sin
        front_y = across[0] * cos + ahead[0] * sin
        resistance = 0.15 * np.tanh(v_x / 0.1) + 0.01 * v_x**2
        return np.array(
            [
                v_x * np.cos(psi) - v_y * np.sin(psi),
                v_x * np.sin(psi) + v_y * np.cos(psi),
                (ahead[1] + front_x) / m - resistance + v_y * omega,
                omega,
                (across[1] + front_y) / m - v_x * omega,
                (l_f * front_y - l_r * across[1]) / CAR.yaw_inertia,
                np.clip(u[1], -CAR.steering_rate, CAR.steering_rate),
            ]
        )


def track() -> Path:
    """Straights joined by circles of `RADII`, whose curvature is smoothed over 0.45 m."""
    corners, points = np.array(CORNERS, dtype=np.float64), []
    for i, (corner, radius) in enumerate(zip(corners, RADII, strict=True)):
        before, after = corner - corners[i - 1], corners[(i + 1) % len(corners)] - corner
        before, after = before / np.linalg.norm(before), after / np.linalg.norm(after)
        side = float(np.sign(before[0] * after[1] - before[1] * after[0]))
        centre = corner + radius * (after - before)  # all corners are right angles
        start = np.arctan2(*(-side * np.array([before[0], -before[1]])))
        angles = start + side * np.linspace(0.0, 0.5 * np.pi, int(radius * 1.57 / 0.05))
        points.append(centre + radius * np.column_stack([np.cos(angles), np.sin(angles)]))
    ring = np.vstack([*points, points[0][:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))])
    s = np.arange(0.0, along[-1], 0.05)
    even = np.column_stack([np.interp(s, along, ring[:, axis]) for axis in (0, 1)])
    mean = np.mean([np.roll(even, k, axis=0) for k in range(-4, 5)], axis=0)
    return Path.from_points(mean, closed=True, widths=np.full((len(mean), 2), HALF_WIDTH))


def record(path: Path, mu: float, file: File, seconds: float, seed: int) -> None:
    """Write a log of pure pursuit with rising speed and rough inputs; columns t, states, a_x."""
    rng = np.random.default_rng(seed)
    x, y, yaw, *_ = (float(column[0]) for column in path.sample(np.zeros(1)))
    car, s, rows = Car(), 0.0, []
    car.reset(np.array([x, y, 1.0, yaw, 0.0, 0.0, 0.0]))
    noise = np.array([NOISE.v_x, NOISE.v_y, NOISE.omega, NOISE.delta])
    rough_steering = rough_drive = late = 0.0
    count = int(seconds / DT)
    for k in range(count):
        found = path.project(car.state[:2], s)
        s, v_x = found.s, car.state[2]
        if abs(found.lateral) > HALF_WIDTH or v_x < 0.0 or abs(car.state[4]) > 4.0:
            x, y, yaw, *_ = (float(column[0]) for column in path.sample(np.array([s])))
            car.reset(np.array([x, y, 1.0, yaw, 0.0, 0.0, 0.0]))
            late += 1.0
            continue
        look = max(0.5, 0.35 * v_x)
        t_x, t_y, *_ = (float(column[0]) for column in path.sample(np.array([s + look])))
        bend = np.abs(path.sample(s + np.linspace(0.0, max(1.0, 0.6 * v_x), 20))[3]).max()
        wanted = min(5.5, np.sqrt((0.3 + 0.75 * k / count) * mu * 9.81 / max(bend, 0.03)))
        aside = np.arctan2(t_y - car.state[1], t_x - car.state[0]) - car.state[3]
        angle = np.arctan(2.0 * (CAR.l_f + CAR.l_r) * np.sin(aside) / look)
        rough_steering = 0.9 * rough_steering + rng.normal(0.0, 0.03)
        rough_drive = 0.95 * rough_drive + rng.normal(0.0, 0.6)
        angle = float(np.clip(angle + rough_steering, -CAR.steering_angle, CAR.steering_angle))
        rate = np.clip((angle - car.state[6]) / 0.08, -CAR.steering_rate, CAR.steering_rate)
        a = np.clip(4.0 * (wanted - v_x) + rough_drive, -9.0 * mu, min(CAR.a_max, 8.8 * mu))
        measured = car.state[[2, 4, 5, 6]] + noise * rng.standard_normal(4)
        rows.append([k * DT + late, *measured, a])
        car.step(np.array([CAR.mass * a, rate]), DT, mu)
    np.savetxt(file, rows, "%.6g", ",", header=",".join(COLUMNS), comments="")


def library(folder: File, path: Path, vehicle: File) -> File:
    """Make a library of a log of 90 s on each surface, as a user does."""
    data = []
    for seed, (surface, mu) in enumerate(SURFACES.items()):
        log, dataset = folder / f"{surface}.csv", folder / f"{surface}.parquet"
        record(path, mu, log, 90.0, seed)
        named = [f"--surface={surface}", f"--friction={mu}"]
        named += [f"--column={name}={name}:{unit}" for name, unit in COLUMNS.items()]
        command = ["egp", "collect", "--from-log", str(log), "--vehicle", str(vehicle), *named]
        subprocess.run([*command, "-o", str(dataset)], check=True, stdout=subprocess.DEVNULL)
        data.append(str(dataset))
    made = folder / "library.safetensors"
    command = ["egp", "train", *data, "--vehicle", str(vehicle), "-o", str(made)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return made


def scenario(folder: File, path: Path) -> Scenario:
    """Make the library, and a scenario of a lap with it at 85 % of the grip."""
    vehicle, track = folder / "car.toml", folder / "track.csv"
    vehicle.write_text(dumps(CAR.fields()), encoding="utf-8")
    x, y, *_ = path.sample(np.arange(0.0, path.length - 0.05, 0.1))
    rows = np.column_stack([x, y, np.full((len(x), 2), HALF_WIDTH)])
    np.savetxt(track, rows, "%.6f", ",", header="x_m,y_m,w_tr_right_m,w_tr_left_m")
    return Scenario(
        "model-car",
        Track("csv", file=str(track)),
        tuple(Zone(s, mu) for s, mu in ZONES),
        zones_in_metres=True,
        library=str(library(folder, path, vehicle)),
        plant="model_car:Car",
        vehicle_file=str(vehicle),
        speed=Speed(grip=0.85, v_max=6.0, knows="zones"),
        measurement=NOISE,
    )


def run(lap: Scenario, belief: RoadBelief | None = None) -> Run:
    """Drive a lap."""
    with Controller(lap.library, lap.control, gate=CAR.gate_limits()) as controller:
        return drive(lap, controller, lambda _: None, belief)


def medians(runs: list[Run]) -> str:
    """Give the medians of lap time and of the largest and RMS lateral error."""
    lateral = [run.trace.lateral_error for run in runs]
    time = np.median([run.summary.periods * run.dt for run in runs])
    most = np.median([np.abs(row).max() for row in lateral])
    rms = np.median([np.sqrt(np.mean(row**2)) for row in lateral])
    completed = sum(run.summary.ending.completed for run in runs)
    return f"{completed} of {len(runs)} | {time:.2f} s | {most:.3f} m | {rms:.3f} m |"


def main() -> None:
    """Record, train, drive and print."""
    path = track()
    with TemporaryDirectory() as folder:
        known = scenario(File(folder), path)
        print("| `cost` | completed | lap | beside the path, max | RMS |\n|---|---|---|---|---|")
        for name, cost in COSTS.items():
            control: dict[str, object] = {"cost": cost}
            runs = [run(replace(known, control=control, seed=seed)) for seed in SEEDS]
            print(f"| {name} | {medians(runs)}", flush=True)
        unknown = replace(known, speed=replace(known.speed, knows="nothing"))
        print("\n| belief | lap | completed | time | beside, max | RMS |\n|---" + 5 * "|---" + "|")
        for name, scale in (
            ("of a full-size car", 1.0),
            ("defaults", new_belief(known, path).scale),
        ):
            beliefs = [RoadBelief(build_path(unknown), scale=scale) for _ in SEEDS]
            for lap in range(LAPS):
                runs = []
                for seed, belief in zip(SEEDS, beliefs, strict=True):
                    runs.append(run(replace(unknown, seed=100 * lap + seed), belief))
                    belief.leave()
                print(f"| {name} | {lap + 1} | {medians(runs)}", flush=True)


if __name__ == "__main__":
    main()
